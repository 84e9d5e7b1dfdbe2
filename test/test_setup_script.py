"""Set-up and build refuse in their first second what they cannot do, and mend what an interruption left."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PIP = """#!/bin/bash
if [[ $1 == -m && $2 == pip ]]; then
  [[ $3 != install ]] || { echo "$*" >>"$CALLS"; cat "$COMPLAINT" >&2; exit "$(wc -l <"$COMPLAINT")"; }
  exit 0
fi
exec PYTHON "$@"
"""
"""The environment's Python, pip left out: what it is asked for is written down, what it complains of is given."""


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """The parts of the workspace that the scripts read, in a folder of its own."""
    folder = tmp_path / "workspace"
    folder.mkdir()
    for name in ("scripts", "requirements"):
        shutil.copytree(ROOT / name, folder / name)
    return folder


def script(workspace: Path, name: str, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {
        key: value for key, value in os.environ.items() if key not in ("ROS_DISTRO", "AMENT_PREFIX_PATH", "PYTHON")
    }
    return subprocess.run(
        [workspace / "scripts" / name, *arguments],
        capture_output=True,
        text=True,
        env={**environment, **variables},
        timeout=60.0,
        check=False,
    )


def make_environment(workspace: Path, complaint: str = "") -> Path:
    """Put an environment whose pip does nothing where set-up looks for it; return the file of pip's calls."""
    python = workspace / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(PIP.replace("PYTHON", sys.executable))
    python.chmod(0o755)
    (workspace / "complaint").write_text(complaint)
    (workspace / "calls").touch()
    return workspace / "calls"


def set_up(workspace: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    calls, complaint = str(workspace / "calls"), str(workspace / "complaint")
    arguments = arguments or ("requirements/development.txt",)
    return script(workspace, "setup", *arguments, CALLS=calls, COMPLAINT=complaint, **variables)


def refusal(answer: subprocess.CompletedProcess[str]) -> str:
    assert answer.returncode == 1, answer.stdout
    (line,) = answer.stderr.splitlines()
    return line


@pytest.mark.fault
@pytest.mark.parametrize("name", ["my work", "a:b", "a;b", "it's"])
@pytest.mark.parametrize("which", ["setup", "build"])
def test_a_path_that_ros_does_not_stand_is_refused_at_once(workspace: Path, which: str, name: str) -> None:
    moved = workspace.rename(workspace.with_name(name))
    line = refusal(script(moved, which, "requirements/development.txt"))
    assert line.startswith(f"{which}: the folder '{moved}' has a space or one of")
    assert line.endswith("move the workspace")
    assert not (moved / ".venv").exists()


@pytest.mark.fault
@pytest.mark.parametrize("python", ["/bin/true", "nowhere/python3"])
def test_a_python_that_does_not_serve_is_refused(workspace: Path, python: str) -> None:
    assert refusal(set_up(workspace, PYTHON=python)) == f"setup: PYTHON={python} is no CPython 3.11 or 3.12"


@pytest.mark.fault
def test_a_shell_of_another_workspace_is_not_an_installed_ros(workspace: Path, tmp_path: Path) -> None:
    other = f"{tmp_path}/other/.venv"
    line = refusal(set_up(workspace, ROS_DISTRO="jazzy", VIRTUAL_ENV=other, AMENT_PREFIX_PATH=f"/a:{other}"))
    assert line.startswith(f"setup: the ROS of another workspace, {tmp_path}/other, is on this shell's paths.")
    assert not (workspace / ".venv").exists()


@pytest.mark.fault
def test_missing_headers_are_said_before_anything_is_installed(workspace: Path, tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text(f'#!/bin/bash\n[[ $2 == *get_path* ]] && echo /nowhere && exit\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    assert "no Python.h in /nowhere: install the Python headers" in refusal(set_up(workspace, PYTHON=str(python)))
    assert not (workspace / ".venv").exists()


@pytest.mark.fault
def test_an_environment_made_by_hand_is_set_up_all_the_same(workspace: Path) -> None:
    calls = make_environment(workspace)
    answer = set_up(workspace)
    assert answer.returncode == 0, answer.stderr
    assert (workspace / ".venv" / "ros").read_text() == "wheels\n"
    first, second = calls.read_text().splitlines()
    assert first.endswith("--no-deps --require-hashes -r requirements/lock/wheels-development.txt")
    assert second.endswith("-r requirements/torch.txt")
    again = set_up(workspace)
    assert (again.returncode, again.stdout) == (0, "")
    assert len(calls.read_text().splitlines()) == 2


@pytest.mark.fault
def test_an_interrupted_set_up_is_made_anew(workspace: Path) -> None:
    make_environment(workspace)
    (workspace / ".venv" / "unfinished").touch()
    (workspace / ".venv" / "half").touch()
    headers = workspace / "python"
    headers.write_text(f'#!/bin/bash\n[[ $2 == venv ]] && exit 1\nexec {sys.executable} "$@"\n')
    headers.chmod(0o755)
    answer = set_up(workspace, PYTHON=str(headers))
    assert "the last set-up was interrupted: making .venv anew" in answer.stdout
    assert "no environment could be made" in answer.stderr
    assert not (workspace / ".venv" / "half").exists()
    assert (workspace / ".venv" / "unfinished").exists()


@pytest.mark.fault
@pytest.mark.parametrize(
    ("complaint", "words", "unfinished"),
    [
        ("WARNING: Retrying (Retry(total=0)) after connection broken\n", "the package index cannot be reached", False),
        ("ERROR: THESE PACKAGES DO NOT MATCH THE HASHES\n", "setup: pip failed with exit code 1 (above)", False),
        ("ERROR: [Errno 28] No space left on device\n", "No space left on device", True),
    ],
)
def test_a_failure_of_pip_says_its_reason(workspace: Path, complaint: str, words: str, unfinished: bool) -> None:
    make_environment(workspace, complaint)
    answer = set_up(workspace)
    assert answer.returncode == 1
    assert words in answer.stderr
    assert (workspace / ".venv" / "unfinished").exists() == unfinished
    assert not list((workspace / ".venv").glob("stamp-*"))


@pytest.mark.fault
def test_a_new_shell_gets_the_ros_below_as_well(workspace: Path) -> None:
    """`local_setup` alone leaves out an installed ROS, and with it rclpy."""
    for name, text in (
        (".venv/bin/activate", ""),
        (".venv/ros", "apt\n"),
        ("install/local_setup.bash", "export PARTS=own\n"),
        ("install/setup.bash", "export PARTS=ros+own\n"),
    ):
        path = workspace / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    answer = subprocess.run(
        ["bash", "-c", f"source {workspace}/scripts/workspace.bash && echo $PARTS"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout == "ros+own\n"


def test_every_package_is_locked_by_version_and_hash() -> None:
    for lock in sorted((ROOT / "requirements" / "lock").glob("*.txt")):
        blocks = lock.read_text().replace("\\\n", " ").splitlines()
        assert all(line.startswith(("#", "-r ")) or ("==" in line and "--hash=sha256:" in line) for line in blocks)
        assert "://" not in lock.read_text()


def test_the_locks_hold_the_versions_of_the_requirements() -> None:
    for ros in ("wheels", "apt"):
        locked = "".join(path.read_text() for path in (ROOT / "requirements" / "lock").glob(f"{ros}-*.txt")).lower()
        for name in (f"ros-{ros}", "runtime", "simulation", "training", "development"):
            for line in (ROOT / "requirements" / f"{name}.txt").read_text().splitlines():
                if not line.startswith(("#", "-r ")):
                    wanted, _, marker = line.partition(";")
                    package, version = wanted.strip().lower().replace("_", "-").split("==")
                    if ros == "apt" and 'python_version < "3.12"' in marker:
                        continue  # an apt-installed Jazzy has CPython 3.12
                    assert f"{package.partition('[')[0]}=={version}" in locked, f"run 'make lock': {line}"

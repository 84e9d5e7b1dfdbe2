"""Start and end of a node's process: one-line startup errors, and prompt shutdown. Real processes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

HERE = Path(__file__).parent
pytestmark = pytest.mark.fault


def start(log: Path, *arguments: str, shell: str = "", **environment: str | None) -> subprocess.Popen:
    known = {**os.environ, **environment}
    command = [sys.executable, str(HERE / "failing_node.py"), *arguments]
    if shell:
        command = ["bash", "-c", f'{shell}; exec "$@"', "bash", *command]
    with log.open("wb") as stream:
        return subprocess.Popen(
            command,
            stdout=stream,
            stderr=subprocess.STDOUT,
            env={name: value for name, value in known.items() if value is not None},
        )


def wait_for(log: Path, words: str, process: subprocess.Popen) -> None:
    deadline = time.monotonic() + 120.0
    while words not in log.read_text():
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("shell", "environment", "words"),
    [
        ("ulimit -n 12", {}, "only 12 files may be open at once: a node needs 64, raise it with ulimit -n"),
        ("", {"HOME": None, "ROS_LOG_DIR": None, "ROS_HOME": None}, "HOME is not set"),
        ("", {"ROS_LOG_DIR": "/dev/null/log"}, "ROS cannot write its log to /dev/null/log"),
    ],
    ids=["open files", "no home", "no place for the log"],
)
def test_what_it_lacks_is_said_in_one_line(tmp_path: Path, shell: str, environment: dict, words: str) -> None:
    log = tmp_path / "log"
    assert start(log, shell=shell, **environment).wait(120.0) == 2
    (line,) = log.read_text().splitlines()
    assert line.startswith("failing_node.py: ")
    assert words in line


REFUSALS = (
    ("value:=[]", "parameter 'value' is not set: must be a number"),
    ("text:=" + "a" * 5000, "parameter 'text' has 5000 letters: at most 4096"),
    ("file:=" + "a" * 250, "a part of the path has 250 letters"),
    ("file:=" + "a" * 250, "a part of the path has 250 letters"),
    ("name:=../../x.yaml", "'../../x.yaml' is no name of ROS"),
    ("names:=[/my-scan]", "'/my-scan' is no name of ROS"),
)


def test_a_bad_parameter_is_refused_in_one_line(in_turn, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{HERE}:{os.environ.get('PYTHONPATH', '')}")
    ends = in_turn("failing_node", [["--ros-args", "-p", parameter] for parameter, _ in REFUSALS])
    for (code, errors, output), (_, words) in zip(ends, REFUSALS, strict=True):
        (line,) = (errors + output).splitlines()
        assert (code, words in line) == (2, True), line


def test_what_yaml_misreads_is_understood(tmp_path: Path) -> None:
    log = tmp_path / "log"
    given = ("text:=nan", "names:=[]", "file:=~/some.file")
    process = start(log, "--ros-args", *(part for each in given for part in ("-p", each)), HOME=str(tmp_path))
    wait_for(log, "runs", process)
    process.terminate()
    process.wait(120.0)
    assert f"text 'nan', names [''], file '{tmp_path}/some.file'" in log.read_text()


def test_an_unexpected_error_at_the_start_is_one_line(tmp_path: Path) -> None:
    log = tmp_path / "log"
    assert start(log, "--ros-args", "-p", "text:=crash").wait(120.0) == 1
    assert log.read_text().splitlines() == ["failing_node.py: could not start: LookupError: nothing of the kind"]


def test_log_level_debug_shows_its_traceback(tmp_path: Path) -> None:
    log = tmp_path / "log"
    assert start(log, "--ros-args", "-p", "text:=crash", "--log-level", "debug").wait(120.0) == 1
    assert "Traceback" in log.read_text()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_cuts_the_start_off(tmp_path: Path, number: int) -> None:
    log = tmp_path / "log"
    process = start(log, "--stuck")  # for a minute
    wait_for(log, "works", process)
    process.send_signal(number)
    assert process.wait(120.0) == 0
    assert "Traceback" not in log.read_text()


def test_without_an_events_executor_it_says_so_and_runs(tmp_path: Path) -> None:
    log = tmp_path / "log"
    process = start(log, "--without-events")
    wait_for(log, "this rclpy has no EventsExecutor", process)
    process.send_signal(signal.SIGINT)
    assert process.wait(120.0) == 0


def shared_memory(process: subprocess.Popen) -> bool:
    return "/dev/shm/fastrtps_" in Path(f"/proc/{process.pid}/maps").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "environment", "shares"),
    [
        ((), {}, True),
        (("--drives",), {}, False),
        (("--drives",), {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}, True),
    ],
    ids=["others share memory", "what drives does not", "unless the user says so"],
)
def test_what_drives_a_robot_shares_no_memory(tmp_path: Path, options: tuple, environment: dict, shares: bool) -> None:
    log = tmp_path / "log"
    # With LOCALHOST rmw_fastrtps takes its own transports, whatever anyone says.
    process = start(log, *options, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET", **environment)
    wait_for(log, "runs", process)
    assert shared_memory(process) is shares
    process.terminate()
    assert process.wait(120.0) == 0


def test_a_middleware_that_hangs_at_the_end_does_not_keep_the_process() -> None:
    """A C call that never returns while holding Python's lock, after the node has done its work."""
    code = (
        "import ctypes; from ctrl_rl_core.ros import running; running._FAREWELL_S = 0.5\n"
        "with running._soon(): ctypes.PyDLL(None).pause()"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120.0)
    assert (answer.returncode, answer.stderr) == (1, "")

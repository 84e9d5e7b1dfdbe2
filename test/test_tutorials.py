"""The tutorials work as written: their commands are run one after the other, in an empty folder."""

import os
import re
import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = ROOT / "docs" / "tutorials"
QUICK = {"own_system"}
"""Those that take less than half a minute; they are part of `make test`."""
_BLOCK = re.compile(r"^```bash\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def pages() -> list[object]:
    names = sorted(page.stem for page in TUTORIALS.glob("*.md"))
    assert len(names) >= 7
    patient = pytest.mark.timeout(1800)
    return [pytest.param(name, marks=(patient,) if name in QUICK else (patient, pytest.mark.slow)) for name in names]


@pytest.mark.parametrize("name", pages())
def test_a_tutorial_works_as_written(name: str, tmp_path: Path) -> None:
    blocks = _BLOCK.findall((TUTORIALS / f"{name}.md").read_text(encoding="utf-8"))
    assert blocks
    # Jobs as in a terminal, each a process group of its own; what is left of them ends with the shell.
    jobs = "set -m; trap 'for job in $(jobs -p); do kill -KILL -- -$job; done' EXIT"
    script = "\n".join(("set -eo pipefail", jobs, f". '{ROOT}/scripts/workspace.bash'", *blocks))
    said = tmp_path / "said.txt"  # no pipe, which what it starts in the background would hold open
    with said.open("wb") as log:
        shell = subprocess.Popen(
            ["bash", "-c", script], cwd=tmp_path, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        )
    try:
        shell.wait()
    finally:
        with suppress(ProcessLookupError):  # what it left in the background
            os.killpg(shell.pid, signal.SIGKILL)
    assert shell.returncode == 0, said.read_text(errors="replace")

"""Work in several processes: completeness, reports of kills, and no survivors of a dead parent."""

import os
import signal
import subprocess
import sys
import time

import pytest

from ctrl_rl_core import WorkersError, map_in_processes

_prepared = []


def prepare(offset):
    _prepared.append(offset)


def add(number):
    return number + _prepared[0]


def refuse(number):
    raise ValueError(f"not {number}")


def die(_number):
    os.kill(os.getpid(), signal.SIGKILL)


def note_and_wait(file):
    file.write_text(str(os.getpid()), encoding="ascii")
    time.sleep(60.0)


def test_every_item_is_answered_once():
    ticks = []
    answers = map_in_processes(add, range(7), 2, prepare, (100,), lambda: ticks.append(1))
    assert sorted(answers) == [100, 101, 102, 103, 104, 105, 106]
    assert ticks


def test_what_a_worker_raises_is_raised_here():
    with pytest.raises(ValueError, match="not 3"):
        list(map_in_processes(refuse, [3], 1))


def test_without_a_number_there_is_a_worker_for_each_core_and_without_items_none():
    assert sorted(map_in_processes(add, range(5), 0, prepare, (100,))) == [100, 101, 102, 103, 104]
    assert list(map_in_processes(die, [])) == []


def test_a_killed_worker_is_told_in_words():
    with pytest.raises(WorkersError, match="run the same command again"):
        list(map_in_processes(die, [1], 1))


PARENT = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_workers import note_and_wait
from ctrl_rl_core.processes.workers import map_in_processes
if __name__ == "__main__":
    list(map_in_processes(note_and_wait, [Path(sys.argv[2])], 1))
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_no_worker_outlives_its_parent(tmp_path, how):
    program, note = tmp_path / "parent.py", tmp_path / "pid"
    program.write_text(PARENT, encoding="utf-8")
    here = os.path.dirname(__file__)
    with subprocess.Popen([sys.executable, str(program), here, str(note)], stderr=subprocess.DEVNULL) as parent:
        _until(lambda: note.exists() and note.read_text(encoding="ascii"))
        parent.send_signal(how)
    worker = int(note.read_text(encoding="ascii"))
    _until(lambda: not _alive(worker))


def _alive(process):
    try:
        with open(f"/proc/{process}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def _until(done):
    deadline = time.monotonic() + 120.0
    while not done():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)

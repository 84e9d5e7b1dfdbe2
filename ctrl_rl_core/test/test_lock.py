"""A lock excludes others until its holder ends, in any way."""

import subprocess
import sys

import pytest

from ctrl_rl_core import LockError, exclusive_lock

HOLD = """
import sys
from pathlib import Path
from ctrl_rl_core.processes.exclusive_lock import exclusive_lock
with exclusive_lock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_one_at_a_time(tmp_path):
    lock = tmp_path / ".lock"
    with (
        exclusive_lock(lock),
        pytest.raises(LockError, match="another process is using this folder"),
        exclusive_lock(lock),
    ):
        pass
    with exclusive_lock(lock):
        pass
    with exclusive_lock(lock), exclusive_lock(tmp_path / ".other"):
        pass


def test_a_killed_holder_lets_others_in(tmp_path):
    lock = tmp_path / ".lock"
    command = [sys.executable, "-c", HOLD, str(lock)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(LockError), exclusive_lock(lock):
            pass
        holder.kill()
    with exclusive_lock(lock):
        pass

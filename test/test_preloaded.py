"""A forked program is a process of its own, and does not outlive the tests."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from preloaded import Preloaded

PARENT = """
import os, signal, subprocess, sys
sys.path.insert(0, {folder!r})
from preloaded import Preloaded
print(Preloaded([sys.executable, "-c", "import signal; signal.pause()"]).pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""
ENDS = """
import atexit, threading
atexit.register(print, "the end")
def work():
    threading.main_thread().join()
    print("the work")
threading.Thread(target=work).start()
"""
PROGRAM = "import os, sys; print(sys.argv, os.environ['WORD'], os.getcwd()); sys.exit('no more')"


def test_it_has_its_own_arguments_environment_folder_streams_and_exit_code(tmp_path: Path) -> None:
    pipe = subprocess.PIPE
    process = Preloaded(
        [sys.executable, "-c", PROGRAM, "one"],
        cwd=tmp_path,
        env={**os.environ, "WORD": "two"},
        stdout=pipe,
        stderr=pipe,
        text=True,
    )
    assert process.communicate(timeout=120.0) == (f"['-c', 'one'] two {tmp_path}\n", "no more\n")
    assert process.returncode == 1


def test_it_ends_after_its_threads_and_what_was_registered_for_the_end() -> None:
    process = Preloaded([sys.executable, "-c", ENDS], stdout=subprocess.PIPE, text=True)
    assert process.communicate(timeout=120.0) == ("the work\nthe end\n", None)
    assert process.returncode == 0


def test_its_end_by_a_signal_is_seen() -> None:
    process = Preloaded([sys.executable, "-c", "import signal; signal.pause()"])
    assert process.poll() is None
    process.kill()
    assert process.wait(120.0) == -signal.SIGKILL


def test_each_of_several_threads_owns_its_processes() -> None:
    def exit_code(number: int) -> int:
        return Preloaded([sys.executable, "-c", f"raise SystemExit({number})"]).wait(120.0)

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(exit_code, range(64))) == list(range(64))


def test_it_ends_with_who_started_it() -> None:
    code = PARENT.format(folder=str(Path(__file__).parent))
    parent = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=False, timeout=120.0)
    assert parent.returncode == -signal.SIGKILL
    state = Path(f"/proc/{int(parent.stdout)}/stat")
    deadline = time.monotonic() + 120.0
    while state.exists() and state.read_text().rsplit(")", 1)[1].split()[0] != "Z":
        assert time.monotonic() < deadline, "it lives on"
        time.sleep(0.02)

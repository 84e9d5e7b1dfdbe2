"""Processes that are interrupted or killed at any moment: one line at most, and nobody left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from _attack import Attack
from ament_index_python.packages import get_package_prefix
from ctrl_rl_core.processes import STOP_SIGNALS

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts" / "reference"))
from workspace import executables  # noqa: E402  (a folder that is run, not installed)

Random = np.random.Generator
_LONGEST_S = 60.0
_NOTHING = ("train", "evaluate", "plot", "barn", "loop", "compile", "hardness")
"""Executables that, without a word, would begin what takes hours or writes into the workspace."""


class Started:
    """A process in a session of its own, which has come so far that it handles signals.

    Args:
        package: Package of the executable.
        name: Name of the executable.
        words: Its arguments.
        folder: Folder in which it works, and its output lies.
    """

    def __init__(self, package: str, name: str, words: tuple[str, ...], folder: Path) -> None:
        self.name, self.log = f"{package} {name}", folder / "log"
        file = Path(get_package_prefix(package)) / "lib" / package / name
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [file, *words],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                cwd=folder,
                env={**os.environ, "ROS_LOG_DIR": str(folder / "ros")},
                start_new_session=True,
            )
        until = time.monotonic() + _LONGEST_S
        while self.process.poll() is None and not self._handles() and time.monotonic() < until:
            time.sleep(0.002)

    def _handles(self) -> bool:
        """Tell whether Python's own start is over; before, a signal ends the interpreter as it does any."""
        try:
            lines = Path(f"/proc/{self.process.pid}/status").read_text().splitlines()
        except OSError:
            return False
        caught = next((int(line.split()[1], 16) for line in lines if line.startswith("SigCgt")), 0)
        return bool(caught >> (signal.SIGTERM - 1) & 1)

    def session(self) -> list[int]:
        """Return the processes of the session that live."""
        out = []
        for entry in Path("/proc").iterdir():
            try:
                if entry.name.isdigit():
                    state, _, _, session = (entry / "stat").read_text().rpartition(")")[2].split()[:4]
                    if int(session) == self.process.pid and state != "Z":
                        out.append(int(entry.name))
            except (OSError, ValueError):
                continue
        return out

    def check_end(self, number: int, moment: str) -> None:
        """Check that it ends after a signal, leaves nobody, and has said nothing ugly."""
        where = f"{self.name}, {signal.Signals(number).name if number < signal.SIGRTMIN else number} {moment}"
        try:
            code = self.process.wait(_LONGEST_S)
            until = time.monotonic() + _LONGEST_S
            while (left := self.session()) and time.monotonic() < until:
                time.sleep(0.05)
            said = self.log.read_text(errors="replace")
            assert not left, f"{where}: {len(left)} processes are left: {said[-500:]}"
            assert "Traceback" not in said, f"{where}: {said[-1500:]}"
            assert code in (0, 1, 2, 130) or number == signal.SIGKILL, f"{where}: code {code}: {said[-500:]}"
        except subprocess.TimeoutExpired:
            raise AssertionError(f"{where}: it does not end") from None
        finally:
            for pid in self.session():
                os.kill(pid, signal.SIGKILL)
            self.process.wait()


def interrupt(random: Random, folder: Path) -> None:
    """Start ten executables, and send each a signal while it imports, works or ends."""
    chosen = [each for each in executables() if each.name not in _NOTHING]
    for k in range(10):
        each, number = chosen[int(random.integers(len(chosen)))], int(random.choice(STOP_SIGNALS))
        place, delay = folder / str(k), float(random.exponential(0.4))
        place.mkdir()
        started = Started(each.package, each.name, (), place)
        time.sleep(delay)
        started.process.send_signal(number)
        started.check_end(number, f"after {delay:.2f} s")


def orphan(random: Random, folder: Path) -> None:
    """End a demo at any moment of its start, drive or end, in a gentle way or not."""
    number = int(random.choice([signal.SIGKILL, signal.SIGHUP, signal.SIGTERM, signal.SIGINT, signal.SIGQUIT]))
    delay = float(random.uniform(0.0, 25.0))
    name = str(random.choice(["demo", "options_demo"]))
    started = Started("ctrl_rl_bringup", name, ("--output", str(folder / "run"), "--speed", "4"), folder)
    time.sleep(delay)
    started.process.send_signal(number)
    started.check_end(number, f"after {delay:.2f} s")


def launch_pairs(_random: Random, _folder: Path) -> None:
    """Start each pair of documented launch files, where ROS's own launch is installed."""
    file = "ctrl_rl_bringup/test/test_launch_pairs.py"
    command = [sys.executable, "-m", "pytest", "-m", "fault", "-q", "--no-header", "--tb=short", file]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout[-4000:]


ATTACKS = [
    Attack(
        "signals",
        "Any executable that gets a signal at any moment ends in a minute, without a traceback, and leaves nobody.",
        interrupt,
        limit_s=900.0,
    ),
    Attack("orphans", "A demo that ends in any way leaves no node.", orphan, limit_s=240.0),
    Attack(
        "launch-pairs",
        "Launch files started together never drive a robot past its safety filter.",
        launch_pairs,
        limit_s=1800.0,
        repeats=False,
    ),
]

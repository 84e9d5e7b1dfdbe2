"""All signals that end a process are caught, and a node ends with the `ros2` that started it. Real processes."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from ctrl_rl_core.processes.signals import STOP_SIGNALS, interrupt_once

HERE = Path(__file__).parent
pytestmark = pytest.mark.fault
WRAPPER = """import subprocess, sys
process = subprocess.Popen(sys.argv[3:])
while process.returncode is None:
    try:
        process.communicate()
    except KeyboardInterrupt:
        pass
sys.exit(process.returncode)
"""
"""Behaves like `ros2 run PACKAGE NODE`: forwards no signal, and waits through Ctrl-C."""


class Node:
    """A node of `failing_node.py`, started by a command line that ends with it."""

    def __init__(self, folder: Path, *before: object, shell: str = "") -> None:
        self.log = folder / "log"
        command = [*map(str, before), sys.executable, str(HERE / "failing_node.py")]
        if shell:
            command = ["bash", "-c", f'{shell}; exec "$@"', "bash", *command]
        with self.log.open("wb") as stream:
            self.process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT, start_new_session=True)
        self.until(lambda: "runs" in self.log.read_text())
        self.pid = self.process.pid
        if before:
            self.pid = int(Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()[0])

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 120.0
        while not condition():
            assert time.monotonic() < deadline, self.log.read_text()
            time.sleep(0.02)

    def state(self, key: str) -> str:
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith(f"{key}:"))

    def has_ended(self) -> bool:
        try:
            return self.state("State").startswith("Z")
        except OSError:
            return True

    def close(self) -> None:
        for pid in (self.pid, self.process.pid):
            if Path(f"/proc/{pid}").exists():
                os.kill(pid, signal.SIGKILL)
        self.process.wait()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Node]]:
    started: list[Node] = []

    def run(*before: object, shell: str = "") -> Node:
        started.append(Node(tmp_path, *before, shell=shell))
        return started[-1]

    yield run
    for node in started:
        node.close()


def test_a_node_catches_every_signal_that_ends_processes(start: Callable[..., Node]) -> None:
    node = start()
    caught = int(node.state("SigCgt"), 16)
    assert [number for number in STOP_SIGNALS if not caught >> (number - 1) & 1] == []
    named = {"SIGHUP", "SIGINT", "SIGQUIT", "SIGTERM", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGABRT", "SIGPWR", "SIGXCPU"}
    assert named <= {getattr(number, "name", "") for number in STOP_SIGNALS}


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGABRT, signal.SIGRTMIN + 7])
def test_any_of_them_ends_a_node_in_good_order(start: Callable[..., Node], number: int) -> None:
    node = start()
    node.process.send_signal(number)
    assert node.process.wait(120.0) == 0, node.log.read_text()
    assert "Traceback" not in node.log.read_text()


def test_nohup_keeps_a_node_through_the_end_of_its_terminal(start: Callable[..., Node]) -> None:
    node = start(shell="trap '' HUP")
    node.process.send_signal(signal.SIGHUP)
    time.sleep(1.0)
    assert node.process.poll() is None
    node.process.terminate()
    assert node.process.wait(120.0) == 0


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP])
def test_a_node_ends_with_the_ros2_run_that_started_it(start: Callable[..., Node], tmp_path: Path, number: int) -> None:
    wrapper = tmp_path / "ros2"
    wrapper.write_text(WRAPPER)
    node = start(sys.executable, wrapper, "run", "package")
    node.process.send_signal(number)
    node.process.wait(120.0)
    node.until(node.has_ended)


def test_a_node_outlives_any_other_parent(start: Callable[..., Node], tmp_path: Path) -> None:
    """When a shell script, an ssh session or a supervisor ends, the robot keeps driving."""
    wrapper = tmp_path / "script.py"
    wrapper.write_text(WRAPPER)
    node = start(sys.executable, wrapper, "run", "package")
    node.process.kill()
    node.process.wait(120.0)
    time.sleep(1.0)
    assert not node.has_ended()


def test_children_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    child = tmp_path / "child"
    code = (
        "import sys, time; from ctrl_rl_core.processes.children import start_child\n"
        "print(start_child(['sleep', '600']).pid, flush=True); time.sleep(600)"
    )
    with child.open("wb") as stream:
        parent = subprocess.Popen([sys.executable, "-c", code], stdout=stream)
    deadline = time.monotonic() + 120.0
    while not child.read_text().endswith("\n"):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    parent.kill()
    parent.wait()
    while Path(f"/proc/{child.read_text().strip()}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_the_second_signal_does_not_cut_off_what_the_first_began() -> None:
    steps = []

    def work() -> None:
        try:
            signal.raise_signal(signal.SIGHUP)
        finally:
            signal.raise_signal(signal.SIGHUP)
            signal.raise_signal(signal.SIGINT)
            steps.append("the robot stands")

    with pytest.raises(KeyboardInterrupt), interrupt_once():
        work()
    assert steps

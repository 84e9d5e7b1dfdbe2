"""A demo that is interrupted ends its nodes, says so in a line, and leaves a bag that can be read."""

import signal
import subprocess
import time
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from commands import command
from preloaded import Preloaded

FOLDER = Path(get_package_prefix("ctrl_rl_bringup")) / "lib" / "ctrl_rl_bringup"


@pytest.mark.parametrize(
    ("demo", "options", "report", "number"),
    [("demo", ["--random-width"], "report", signal.SIGTERM), ("options_demo", [], "options_report", signal.SIGINT)],
)
def test_an_interrupted_demo_leaves_a_bag_and_no_node(
    tmp_path: Path, demo: str, options: list[str], report: str, number: int
) -> None:
    run, log = tmp_path / "run", tmp_path / "log"
    with log.open("wb") as stream:
        command_line = [FOLDER / demo, "--output", run, "--speed", "4", *options]
        process = Preloaded(command_line, stdout=stream, stderr=subprocess.STDOUT)
    deadline = time.monotonic() + 120.0
    while "% of the way" not in log.read_text():
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.05)
    nodes = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    assert len(nodes) >= 3
    process.send_signal(number)
    assert process.wait(60.0) == 130, log.read_text()
    assert log.read_text().splitlines()[-1] == f"{demo}: interrupted"
    assert "Traceback" not in log.read_text()
    if "--random-width" in options:
        assert "no reward and no time to reach: the corridor's width is drawn at random" in log.read_text()
        assert not (run / "time_to_reach.safetensors").exists()
    assert not any(Path(f"/proc/{node}").exists() for node in nodes)
    answer = command(report, run)
    assert answer.returncode == 1
    assert "0 lost" in answer.stdout


@pytest.mark.fault
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_a_demo_that_is_killed_or_hung_up_leaves_a_bag_and_no_node(tmp_path: Path, number: int) -> None:
    run, log = tmp_path / "run", tmp_path / "log"
    start = subprocess.Popen if number == signal.SIGKILL else Preloaded
    with log.open("wb") as stream:
        words = ["--output", run, "--speed", "4", "--random-width"]  # with no time to reach, which takes seconds
        process = start([FOLDER / "demo", *words], stdout=stream, stderr=stream)
    deadline = time.monotonic() + 120.0
    while "% of the way" not in log.read_text():
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.05)
    nodes = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.send_signal(number)
    process.wait(60.0)
    while any(Path(f"/proc/{node}").exists() for node in nodes):
        assert time.monotonic() < deadline, nodes
        time.sleep(0.05)
    assert command("report", run).returncode == 1

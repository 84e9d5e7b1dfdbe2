"""Measure what the page costs while a robot drives, and take a picture of it.

python test/view_costs [--seconds 300] [--results docs/results/view.json] [--picture docs/images/view.png]

The navigator drives a simulated burger to and fro between two goals in the warehouse, in real time. A visitor's
connection takes everything that the page sends. For the picture this is a headless browser, which renders on the
processor; so that a robot behind the safety filter keeps its model's delays beside that, time runs slower.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
import yaml
from ctrl_rl_core.command import OptionalFileToWrite, Positive
from ctrl_rl_core.ros import DIAGNOSTICS, LATCHED
from ctrl_rl_navigation.cli import TASK_NAME, task_content
from ctrl_rl_navigation.maps import map_file
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from ctrl_rl_core import Result, parse_options, run_command, write_results
from ctrl_rl_msgs.msg import NavigatorStatus

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "test" / "benchmarks"), str(ROOT / "ctrl_rl_bringup" / "test")]
from _common import executable  # noqa: E402  (a folder that is run, not installed)
from browser import Browser  # noqa: E402

MAP, START = "warehouse", (7.5, 0.55, 0.8)
GOALS = (3.7, 6.8), (7.5, 0.8)
TOKEN = "swordfish99"
_BRIDGE = "sim_bridge", "-p", "engine:=planar", "-p", "task:={task}"
_NAVIGATOR = "ctrl_rl_navigation", "-p", "use_sim_time:=true"
ALONE = {"bridge": _BRIDGE, "navigator": _NAVIGATOR}
FILTERED = {
    "bridge": (*_BRIDGE, "-p", "speed_factor:=0.25"),
    "navigator": (*_NAVIGATOR, "-r", "cmd_vel:=cmd_vel_raw"),
    "safety_filter": ("ctrl_rl_safety", "-p", "use_sim_time:=true"),
}
_TICKS = os.sysconf("SC_CLK_TCK")
_FIRST_S = 60.0
"""Time after which memory is compared [s]."""
_START_S = 180.0
"""Longest time until the robot drives [s]."""
_PICTURE_S = 30.0
"""Time of the drive at which the picture is taken [s]."""


@dataclass(frozen=True)
class Options:
    """Measure what the page costs while a robot drives, and take a picture of it."""

    seconds: Positive = 300
    """Time of the measurement [s]."""
    results: OptionalFileToWrite = None
    """JSON file of the results."""
    picture: OptionalFileToWrite = None
    """PNG file to write, by a headless browser; then nothing is measured."""


class Operator(Node):
    """Sends the robot to and fro, and hears what the page says of itself."""

    def __init__(self) -> None:
        super().__init__("operator")
        self.rate, self.reached = 0.0, 0
        self._state = -1
        self._goals = self.create_publisher(PoseStamped, "goal_pose", 10)
        self.create_subscription(NavigatorStatus, "navigator/status", self._on_status, LATCHED)
        self.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 10)

    def spin(self, seconds: float) -> None:
        """Serve it for some time [s]."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            rclpy.spin_once(self, timeout_sec=0.05)

    def wait(self) -> None:
        """Serve it until the robot drives."""
        deadline = time.monotonic() + _START_S
        while self._state != NavigatorStatus.DRIVING:
            if time.monotonic() > deadline:
                raise SystemExit("view_costs: the robot does not drive")
            self.spin(0.5)

    def _on_status(self, message: NavigatorStatus) -> None:
        waits = message.state == NavigatorStatus.WAITING and message.message == "waiting for a goal"
        arrives = message.state == NavigatorStatus.REACHED and self._state != NavigatorStatus.REACHED
        self._state = message.state
        if waits or arrives:
            self.reached += arrives
            goal = PoseStamped()
            goal.header.frame_id = "map"
            goal.pose.position.x, goal.pose.position.y = GOALS[self.reached % 2]
            goal.pose.orientation.w = 0.0  # any heading
            self._goals.publish(goal)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/view":
                self.rate = float({each.key: each.value for each in status.values}["frames a second"])


@contextlib.contextmanager
def started(nodes: dict[str, tuple[str, ...]]) -> Iterator[tuple[subprocess.Popen[Any], str]]:
    """Run the robot and the page; yield the page's process and address."""
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        task = folder / f"{TASK_NAME}.yaml"
        task.write_text(yaml.safe_dump(task_content(map_file(MAP), START), sort_keys=False))
        for node, (package, *words) in nodes.items():
            command = [executable(package, node), "--ros-args", *(word.format(task=task) for word in words)]
            log = stack.enter_context((folder / f"{node}.log").open("wb"))
            stack.callback(end, subprocess.Popen(command, stdout=log, stderr=log))
        command = [executable("ctrl_rl_bringup", "view"), "--port", "0", "--token", TOKEN]
        view = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        stack.callback(end, view)
        assert view.stdout is not None
        yield view, view.stdout.readline().split()[1]


def end(process: subprocess.Popen[Any]) -> None:
    """End a process in good order."""
    process.send_signal(signal.SIGINT)
    process.wait(60.0)


def visit(address: str, received: list[int]) -> None:
    """Take all that the page sends to a visitor until it ends, and count the bytes."""
    import msgspec
    from viser import __version__
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    camera = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 3.0), "fov": 1.0, "near": 0.1, "far": 10.0}
    camera |= {"image_height": 600, "image_width": 800, "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0)}
    protocol: Any = f"viser-v{__version__}"
    with connect(address.replace("http", "ws"), subprotocols=[protocol], max_size=None) as socket:
        socket.send(msgspec.msgpack.encode({"type": "ViewerCameraMessage", **camera}))
        with contextlib.suppress(ConnectionClosed):
            received.extend(len(message) for message in socket)


def processor_s(pid: int) -> float:
    """Return the processor time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def own_memory_mb(pid: int) -> float:
    """Return the memory that a process shares with nobody [MB]."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_")) / 1024.0


def measure(options: Options, operator: Operator) -> None:
    """Measure, print and write the figures."""
    received: list[int] = []
    with started(ALONE) as (view, address):
        visitor = threading.Thread(target=visit, args=(address, received), daemon=True)
        visitor.start()
        operator.wait()
        operator.spin(_FIRST_S)
        before, begin, sent, memory = processor_s(view.pid), time.monotonic(), sum(received), own_memory_mb(view.pid)
        operator.spin(options.seconds - _FIRST_S)
        passed, after = time.monotonic() - begin, own_memory_mb(view.pid)
        share = 100.0 * (processor_s(view.pid) - before) / passed
        rate, bandwidth = operator.rate, 1e-3 * (sum(received) - sent) / passed
    rows = [
        Result("one visitor", "processor share", "% of a core", [share]),
        Result("one visitor", "frames a second", "Hz", [rate]),
        Result("one visitor", "memory", "MB", [after]),
        Result("one visitor", "memory growth", "MB", [after - memory]),
        Result("one visitor", "sent to the visitor", "kB/s", [bandwidth]),
        Result("one visitor", "goals reached meanwhile", "1", [float(operator.reached)]),
    ]
    for row in rows:
        print(f"{row.metric:<24} {row.values[0]:8.2f} {row.unit}")
    if options.results is not None:
        write_results(options.results, "view", [0], rows)


def take_picture(file: Path, operator: Operator) -> None:
    """Write a picture of the page while the robot drives."""
    with started(FILTERED) as (_, address), tempfile.TemporaryDirectory() as folder:
        browser = Browser(Path(folder), address)
        try:
            operator.wait()
            browser.fill("token", TOKEN)
            browser.press("Unlock")
            browser.evaluate("document.querySelectorAll('.mantine-Notification-root').forEach((each) => each.remove())")
            operator.spin(_PICTURE_S)
            browser.screenshot(file)
        finally:
            browser.close()


def run(options: Options) -> int:
    """Do what the options say."""
    rclpy.init()
    operator = Operator()
    try:
        if options.picture is not None:
            take_picture(options.picture, operator)
        else:
            measure(options, operator)
    finally:
        operator.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    given = parse_options("view_costs", Options)
    sys.exit(run_command("view_costs", lambda: run(given)))

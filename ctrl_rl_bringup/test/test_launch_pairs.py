"""Launch files started together never drive a robot round its safety filter. Real launch, real nodes, a fake robot."""

import itertools
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from ament_index_python.packages import get_package_share_directory
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node

from ctrl_rl_core import COMMAND

ROBOT = ("ctrl_rl_bringup", "robot.launch.py")
NAVIGATION = ("ctrl_rl_navigation", "navigation.launch.py", "map:=corridor")
FILTER = ("ctrl_rl_safety", "safety_filter.launch.py")
PATIENCE_S = 120.0
pytestmark = [
    pytest.mark.fault,
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("ros2") is None, reason="ROS's own launch is not installed here"),
]


class FakeRobot:
    """Obeys cmd_vel, and a driver of its own asks for 0.1 m/s all the time."""

    def __init__(self) -> None:
        self.node = Node("fake_robot")
        self.speeds: list[float] = []
        self.node.create_subscription(
            TwistStamped, "cmd_vel", lambda message: self.speeds.append(message.twist.linear.x), COMMAND
        )
        self._raw = self.node.create_publisher(TwistStamped, "cmd_vel_raw", COMMAND)
        self.node.create_timer(0.05, self._drive)

    def _drive(self) -> None:
        message = TwistStamped()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.twist.linear.x = 0.1
        self._raw.publish(message)

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, self.speeds[-10:]
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def look(self, seconds: float) -> list[float]:
        """Return the speeds of some time."""
        self.speeds.clear()
        deadline = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > deadline)
        return self.speeds


@pytest.fixture
def robot(_no_shared_memory: None) -> Iterator[FakeRobot]:
    rclpy.init()
    out = FakeRobot()
    yield out
    out.node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Callable[..., Path]]:
    started: list[subprocess.Popen] = []

    def run(package: str, file: str, *arguments: str) -> Path:
        assert (Path(get_package_share_directory(package)) / "launch" / file).is_file()
        log = tmp_path / f"{len(started)}.log"
        with log.open("wb") as stream:
            command = ["ros2", "launch", package, file, *arguments]
            started.append(subprocess.Popen(command, stdout=stream, stderr=stream, start_new_session=True))
        return log

    yield run
    for process in started:
        os.killpg(process.pid, signal.SIGINT)
    for process in started:
        process.wait(60.0)


@pytest.mark.parametrize("pair", list(itertools.permutations((ROBOT, NAVIGATION, FILTER), 2)), ids=str)
def test_two_launch_files_together_do_not_move_the_robot(robot: FakeRobot, launch: Callable[..., Path], pair) -> None:
    logs = [launch(*each) for each in pair]
    robot.until(lambda: robot.node.count_publishers("cmd_vel") == 2)
    robot.until(lambda: all("/watchdog publishes on /cmd_vel too" in log.read_text() for log in logs))
    speeds = robot.look(3.0)
    assert speeds
    assert set(speeds) == {0.0}


@pytest.mark.parametrize("driver", [("navigate:=true",), ("navigate:=false", "filter:=true")], ids=str)
def test_one_launch_file_has_one_watchdog_behind_the_filter(
    robot: FakeRobot, launch: Callable[..., Path], driver: tuple[str, ...]
) -> None:
    log = launch(*ROBOT, *driver, "map:=corridor", "policy:=curved_corridor")
    robot.until(lambda: robot.node.count_publishers("safety_filter/status") == 1)
    robot.until(lambda: robot.node.count_publishers("cmd_vel") == 1)
    speeds = robot.look(3.0)
    assert set(speeds) == {0.0}, "the filter sees nothing: no scan"
    assert robot.node.count_subscribers("cmd_vel_safe") == 2, "the filter's own ear, and the watchdog"
    assert "publishes on /cmd_vel too" not in log.read_text()


def test_without_a_filter_it_drives(robot: FakeRobot, launch: Callable[..., Path]) -> None:
    launch(*NAVIGATION, "filter:=false")
    robot.until(lambda: robot.speeds[-3:] == [0.1] * 3)

"""A velocity driver as a process: commands within limits, stops with a reason, zero velocity at the end."""

import signal
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from preloaded import Preloaded
from rclpy.node import Node

from ctrl_rl_core import COMMAND

DRIVER = '''
import sys
import numpy as np
from ctrl_rl_core.ros.parameters import Parameter
from ctrl_rl_core.ros.node import SENSOR
from ctrl_rl_core.ros.running import run_node
from ctrl_rl_core.driving.commander import VELOCITY_PARAMETERS, Commander, VelocityError
from ctrl_rl_core import RobotNode
from nav_msgs.msg import Odometry


class Echo(RobotNode):
    """Commands what odometry says."""

    PARAMETERS = (*VELOCITY_PARAMETERS, Parameter("scan_timeout", 0.3, "Age [s].", 0.05, 10.0))

    def __init__(self):
        super().__init__("echo")
        self.robot = Commander(self, needs=("odometry",))
        self.robot.set_limits((-0.1, -1.0), (0.2, 1.0))
        self.create_subscription(Odometry, "odom", self.on_odometry, SENSOR)

    def on_odometry(self, message):
        self.robot.note_input("odometry")
        self.robot.use_frame(message.child_frame_id)
        twist = message.twist.twist
        if twist.linear.y:
            raise ZeroDivisionError("a callback's own mistake")
        try:
            self.robot.drive(np.array((twist.linear.x, twist.angular.z)), message.header.stamp)
        except VelocityError as error:
            self.robot.halt(str(error), message.header.stamp)


sys.exit(run_node(Echo))
'''


class Base:
    """The other side: publishes odometry, receives commands."""

    def __init__(self, folder: Path, *parameters: str) -> None:
        rclpy.init()
        self.node = Node("base")
        self.odom = self.node.create_publisher(Odometry, "odom", 10)
        self.commands: list[TwistStamped] = []
        self.node.create_subscription(TwistStamped, "cmd_vel", self.commands.append, COMMAND)
        script = folder / "echo.py"
        script.write_text(textwrap.dedent(DRIVER), encoding="utf-8")
        options = ["--ros-args", *(part for each in parameters for part in ("-p", each))] if parameters else []
        self.log = folder / "echo.log"
        with self.log.open("wb") as stream:
            self.process = Preloaded([sys.executable, script, *options], stdout=stream, stderr=stream)

    def spin(self, seconds: float, until: Callable[[], bool]) -> bool:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not until():
            rclpy.spin_once(self.node, timeout_sec=0.02)
        return until()

    def answer(self, v: float, omega: float) -> TwistStamped:
        """Return the command for odometry with these speeds; repeat until one arrives."""
        message = Odometry(child_frame_id="robot1/base_link")
        message.twist.twist.linear.x, message.twist.twist.angular.z = v, omega
        message.header.stamp.sec = len(self.commands) + 1
        for _ in range(100):
            self.odom.publish(message)
            if self.spin(0.2, lambda: any(each.header.stamp == message.header.stamp for each in self.commands)):
                return next(each for each in self.commands if each.header.stamp == message.header.stamp)
        raise AssertionError(self.log.read_text())

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            self.process.wait(120.0)
        self.node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Base]]:
    """Return a function that starts the driver with parameters."""
    started: list[Base] = []

    def begin(*parameters: str) -> Base:
        started.append(Base(tmp_path, *parameters))
        return started[-1]

    yield begin
    for each in started:
        each.close()


@pytest.mark.fault
def test_what_is_sent_is_finite_within_limits_and_in_the_robots_own_frame(start: Callable[..., Base]) -> None:
    base = start()
    inside = base.answer(0.15, -0.5)
    assert (inside.twist.linear.x, inside.twist.angular.z) == (0.15, -0.5)
    assert inside.header.frame_id == "robot1/base_link"
    for wild in ((1e300, -1e300), (-5.0, 7.0)):
        command = base.answer(*wild).twist
        expected = np.clip(wild, (-0.1, -1.0), (0.2, 1.0))
        assert (command.linear.x, command.angular.z) == tuple(expected)
    for broken in ((np.nan, 0.1), (0.1, np.inf)):
        command = base.answer(*broken).twist
        assert (command.linear.x, command.angular.z) == (0.0, 0.0)
    assert "stopping: the command is" in base.log.read_text()


@pytest.mark.fault
def test_it_stands_without_recent_input_says_so_once_and_leaves_the_robot_standing(start: Callable[..., Base]) -> None:
    base = start("base_frame:=other")
    assert base.answer(0.15, 0.0).header.frame_id == "other", "what is given counts"
    before, said = len(base.commands), base.log.read_text().count("stopping: no recent odometry")

    def since_it_stands() -> list[float]:  # odometry that was sent twice at the start may be answered late
        speeds = [each.twist.linear.x for each in base.commands[before:]]
        return speeds[speeds.index(0.0) :] if 0.0 in speeds else []

    assert base.spin(120.0, lambda: len(since_it_stands()) >= 3)
    assert base.log.read_text().count("stopping: no recent odometry") == said + 1
    assert not any(since_it_stands())
    assert base.answer(0.15, 0.0).twist.linear.x == 0.15, "it goes on by itself"
    before = len(base.commands)
    base.process.send_signal(signal.SIGTERM)
    assert base.process.wait(120.0) == 0
    assert base.spin(120.0, lambda: len(base.commands) > before and base.commands[-1].twist.linear.x == 0.0)


@pytest.mark.fault
def test_a_callback_that_fails_leaves_the_robot_standing_until_it_works_again(start: Callable[..., Base]) -> None:
    base = start("scan_timeout:=10.0")
    assert base.answer(0.15, 0.0).twist.linear.x == 0.15
    before, sideways = len(base.commands), Odometry()
    sideways.twist.twist.linear.y = 1.0
    base.odom.publish(sideways)
    assert base.spin(120.0, lambda: len(base.commands) > before)
    assert base.commands[-1].twist.linear.x == 0.0
    words = "callback failed: on_odometry (odom): ZeroDivisionError: a callback's own mistake"
    assert base.spin(120.0, lambda: words in base.log.read_text())
    for _ in range(3):
        moves = base.answer(0.15, 0.0).twist.linear.x == 0.15
    assert moves, "it goes on by itself"
    assert base.process.poll() is None

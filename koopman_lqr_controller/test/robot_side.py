"""Counterpart of the controller, and a policy for it."""

import time
from array import array
from collections.abc import Callable
from functools import partial

import numpy as np
import rclpy
from ctrl_rl_core.ros import SCAN_PUBLISHER, to_stamp
from geometry_msgs.msg import Twist, TwistStamped
from koopman_lqr_controller.models.encoder import Dense
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

from ctrl_rl_core import COMMAND, RESULT
from ctrl_rl_msgs.msg import LatentState
from koopman_lqr_controller import Encoder, LatentController, LatentPolicy, LinearModel, RobotInterface

PATIENCE_S = 120.0
"""Timeout for an answer that takes a millisecond on an idle machine."""


class Robot:
    """Counterpart of the controller: publishes scans and odometry, and records the commands."""

    def __init__(self, stamped: bool = True) -> None:
        rclpy.init()
        self.node = Node("robot")
        self.scan = self.node.create_publisher(LaserScan, "scan", SCAN_PUBLISHER)
        self.odom = self.node.create_publisher(Odometry, "odom", 10)
        self.commands: list[TwistStamped | Twist] = []
        self.latents: list[LatentState] = []
        kind = TwistStamped if stamped else Twist
        self.node.create_subscription(kind, "cmd_vel", self.commands.append, COMMAND)
        self.node.create_subscription(LatentState, "koopman_lqr_controller/latent", self.latents.append, RESULT)

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()

    def spin(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not until():
            rclpy.spin_once(self.node, timeout_sec=0.02)
        return until()

    def wait_for_controller(self) -> None:
        def found() -> bool:
            listeners = (self.scan.get_subscription_count(), self.odom.get_subscription_count())
            return min(listeners) > 0 and self.node.count_publishers("cmd_vel") > 0

        assert self.spin(PATIENCE_S, found)
        deadline = time.monotonic() + 120.0
        while not self.spin(0.2, lambda: len(self.commands) > 0):  # both ends have matched once a scan is answered
            assert time.monotonic() < deadline
            self.send(corridor(0.0), 1, odometry=False)
        self.spin(0.3)
        self.commands.clear()
        self.latents.clear()

    def send(self, ranges: np.ndarray, nanoseconds: int, odometry: bool = True) -> None:
        if odometry:
            self.odom.publish(Odometry())
        step = 2 * np.pi / len(ranges)
        scan = LaserScan(angle_max=step * (len(ranges) - 1), angle_increment=step, range_min=0.12, range_max=3.5)
        scan.header.stamp = to_stamp(nanoseconds)
        scan.ranges = array("f", ranges.tolist())
        self.scan.publish(scan)

    def thought_of(self, nanoseconds: int, seconds: float = 5.0) -> LatentState:
        """Return the controller's diagnostics of a scan."""
        stamp = to_stamp(nanoseconds)

        def found() -> list[LatentState]:
            return [latent for latent in self.latents if latent.header.stamp == stamp]

        assert self.spin(seconds, lambda: bool(found()))
        return found()[-1]

    def answer_to(self, nanoseconds: int) -> TwistStamped | None:
        stamp = to_stamp(nanoseconds)
        return next((command for command in self.commands if command.header.stamp == stamp), None)


def corridor(offset: float) -> np.ndarray:
    bearing = np.arange(360) * 2 * np.pi / 360
    side = np.where(np.sin(bearing) > 0, 0.35 - offset, 0.35 + offset)
    return np.minimum(side / np.maximum(np.abs(np.sin(bearing)), 1e-6), 3.5)


def answered(robot: Robot, nanoseconds: int) -> bool:
    return robot.answer_to(nanoseconds) is not None


def ask(robot: Robot, ranges: np.ndarray, nanoseconds: int) -> TwistStamped:
    robot.odom.publish(Odometry())
    robot.spin(0.1)  # odometry and scan are two topics: a scan may overtake
    robot.send(ranges, nanoseconds)
    assert robot.spin(PATIENCE_S, partial(answered, robot, nanoseconds))
    answer = robot.answer_to(nanoseconds)
    assert answer is not None
    return answer


def a_policy(observations: int, robot_interface: RobotInterface | None) -> LatentPolicy:
    weight = np.random.default_rng(0).normal(size=(3, observations)).astype(np.float32)
    zeros = np.zeros(1, np.float32)
    encoder = Encoder((Dense(weight, np.zeros(3, np.float32), False),), (observations,), zeros, zeros + 1)
    model = LinearModel(0.9 * np.eye(3), np.ones((3, 2)))
    controller = LatentController(encoder, model, np.ones(3), np.ones(2), np.zeros(3))
    return LatentPolicy(controller, 0.1, robot_interface, {"task": "cheetah_run"})

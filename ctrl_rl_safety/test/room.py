"""Robot in a square room for the node's tests: it follows cmd_vel and sends odometry and scans with faults."""

import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from ctrl_rl_core.ros import LATCHED, float32_array, to_stamp
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import LaserScan
from visualization_msgs.msg import Marker

from ctrl_rl_core import COMMAND
from ctrl_rl_msgs.msg import SafetyStatus

HALF = 0.7
"""Half the side of the room [m]."""
_BEAMS = 180
_STEP, _SCAN_S = 0.02, 0.1


class Room:
    """The robot, its room, and the source of raw commands.

    Attributes:
        raw: Raw command that is sent continuously; None for none.
        scan: Modifier of each scan before it is sent; returns None to drop it.
        odometry: The same for odometry.
        late: Time after which a command takes effect [s].
        commands: Commands received by the robot.
        told: Messages of the filter.
    """

    def __init__(self) -> None:
        self.node = rclpy.create_node("room")
        self.raw: tuple[float, float] | None = (0.0, 0.0)
        self.scan: Callable[[LaserScan], LaserScan | None] = lambda scan: scan
        self.odometry: Callable[[Odometry], Odometry | None] = lambda odometry: odometry
        self.late, self._waiting = 0.0, deque[tuple[float, tuple[float, float]]]()
        self.state, self.command = np.zeros(3), (0.0, 0.0)
        self.commands: list[tuple[float, float]] = []
        self.told: list[SafetyStatus] = []
        self.sets: list[OccupancyGrid] = []
        self.escapes: list[Marker] = []
        self._stepped = self._scanned = time.monotonic()
        make, listen = self.node.create_publisher, self.node.create_subscription
        self._scans, self._odometry = make(LaserScan, "scan", 5), make(Odometry, "odom", 10)
        self._raw = make(TwistStamped, "cmd_vel_raw", COMMAND)
        listen(TwistStamped, "cmd_vel", self._on_command, COMMAND)
        listen(SafetyStatus, "safety_filter/status", self.told.append, 100)
        listen(OccupancyGrid, "safety_filter/set", self.sets.append, LATCHED)
        listen(Marker, "safety_filter/escape", self.escapes.append, 1)

    @property
    def gap(self) -> float:
        """Distance from the robot's centre to the nearest wall [m]."""
        return HALF - float(np.abs(self.state[:2]).max())

    def send_raw(self, v: float, omega: float) -> None:
        message = TwistStamped()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.twist.linear.x, message.twist.angular.z = v, omega
        self._raw.publish(message)

    def until(self, fits: Callable[[], bool], timeout: float = 120.0) -> None:
        """Run until a condition holds."""
        deadline = time.monotonic() + timeout
        while not fits():
            self._step()
            rclpy.spin_once(self.node, timeout_sec=0.005)
            assert time.monotonic() < deadline, (self.told[-1:], self.command, self.state)

    def until_told(self, mode: int, why: str = "") -> SafetyStatus:
        """Run until the filter reports a mode in a new message, with given text in its reason."""
        self.told.clear()
        self.until(lambda: any(each.mode == mode and why in each.why for each in self.told))
        return next(each for each in self.told if each.mode == mode and why in each.why)

    def _on_command(self, message: TwistStamped) -> None:
        command = message.twist.linear.x, message.twist.angular.z
        self.commands.append(command)
        if self.late:
            self._waiting.append((time.monotonic() + self.late, command))
        else:
            self.command = command

    def _step(self) -> None:
        now = time.monotonic()
        passed = now - self._stepped
        if passed < _STEP:
            return
        self._stepped = now
        while self._waiting and self._waiting[0][0] <= now:
            self.command = self._waiting.popleft()[1]
        v, omega = self.command
        x, y, theta = self.state
        self.state = np.array(
            (x + v * math.cos(theta) * passed, y + v * math.sin(theta) * passed, theta + omega * passed)
        )
        stamp = self.node.get_clock().now().to_msg()
        if self.raw is not None:
            self.send_raw(*self.raw)
        odometry = Odometry(child_frame_id="base_footprint")
        odometry.header.stamp, odometry.header.frame_id = stamp, "odom"
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = self.state[:2].tolist()
        turn = 0.5 * float(self.state[2])
        odometry.pose.pose.orientation.z, odometry.pose.pose.orientation.w = math.sin(turn), math.cos(turn)
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = v, omega
        _publish(self._odometry, self.odometry(odometry))
        if now - self._scanned >= _SCAN_S:
            self._scanned = now
            _publish(self._scans, self.scan(self._look(stamp)))

    def _look(self, stamp: Any) -> LaserScan:
        bearings = np.arange(_BEAMS) * (2.0 * math.pi / _BEAMS)
        c, s = np.cos(bearings + self.state[2]), np.sin(bearings + self.state[2])
        with np.errstate(divide="ignore"):
            ranges = np.minimum(
                (HALF - np.sign(c) * self.state[0]) / np.abs(c), (HALF - np.sign(s) * self.state[1]) / np.abs(s)
            )
        out = LaserScan(range_min=0.1, range_max=5.0, angle_increment=2.0 * math.pi / _BEAMS)
        out.angle_max = float(bearings[-1])
        out.header.stamp, out.header.frame_id = stamp, "base_scan"
        out.ranges = float32_array(ranges)
        return out


def _publish(publisher: Any, message: Any) -> None:
    if message is not None:
        publisher.publish(message)


def shifted(message: Any, seconds: float) -> Any:
    """Return a message with a shifted stamp [s]."""
    stamp = message.header.stamp
    message.header.stamp = to_stamp(stamp.sec * 10**9 + stamp.nanosec + round(1e9 * seconds))
    return message

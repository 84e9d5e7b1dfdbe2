"""Stands between simulator and robot topics, and breaks what passes: python test/preflight/relay.py FAULT.

The simulator's topics are remapped to raw/...; each message is sent on, changed, held back or repeated.
"""

from __future__ import annotations

import copy
import sys
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import rclpy
from ctrl_rl_core.navigation import OCCUPIED
from ctrl_rl_core.ros import LATCHED, ODOM_PUBLISHER, SCAN_PUBLISHER, float32_array
from geometry_msgs.msg import TransformStamped, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import BatteryState, LaserScan
from tf2_msgs.msg import TFMessage

from ctrl_rl_core import COMMAND, OccupancyMap, read_planar_pose

TOPICS = ("scan", "odom", "cmd_vel", "tf", "tf_static")
_CELL = 0.05

Change = Callable[[Any, int], Any]
"""From a message and its number to the message that is sent on, None for none."""


def _ranges(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Return the change of a scan's ranges by a function."""

    def changed(message: LaserScan, _number: int) -> LaserScan:
        message.ranges = float32_array(change(np.frombuffer(message.ranges, np.float32)))
        return message

    return changed


def _later(seconds: int) -> Change:
    """Return the change of a message's stamps by some whole seconds; none lies before zero."""

    def changed(message: Any, _number: int) -> Any:
        for each in getattr(message, "transforms", (message,)):
            each.header.stamp.sec = max(0, each.header.stamp.sec + seconds)
        return message

    return changed


def _frozen() -> Change:
    first: list[array] = []

    def changed(message: LaserScan, _number: int) -> LaserScan:
        first.append(message.ranges) if not first else None
        message.ranges = first[0]
        return message

    return changed


def _lost(ranges: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(ranges)) % 10 < 8, np.nan, ranges)


def _mirrored(ranges: np.ndarray) -> np.ndarray:
    return np.roll(ranges[::-1], 1)


def _quarter_turn(ranges: np.ndarray) -> np.ndarray:
    return np.roll(ranges, -len(ranges) // 4)


def _nan_odometry(message: Odometry, _number: int) -> Odometry:
    message.twist.twist.linear.x = float("nan")
    return message


def _swapped_wheels(message: Odometry, _number: int) -> Odometry:
    """Left and right encoders are swapped: every turn has the wrong sign."""
    pose, twist = message.pose.pose, message.twist.twist
    twist.angular.z *= -1.0
    pose.position.y *= -1.0
    pose.orientation.z *= -1.0
    return message


def _large_wheels(message: Odometry, _number: int) -> Odometry:
    """The wheel radius of the odometry is 1.5 times the true one."""
    message.pose.pose.position.x *= 1.5
    message.pose.pose.position.y *= 1.5
    message.twist.twist.linear.x *= 1.5
    return message


def _in_tf(change: Callable[[Odometry], None]) -> Change:
    """Return the change of transforms that a change of the pose of odometry makes."""

    def changed(message: TFMessage, _number: int) -> TFMessage:
        for each in message.transforms:
            odometry, moved = Odometry(), each.transform.translation
            odometry.pose.pose.position.x, odometry.pose.pose.position.y = moved.x, moved.y
            odometry.pose.pose.orientation = each.transform.rotation
            change(odometry)
            moved.x, moved.y = odometry.pose.pose.position.x, odometry.pose.pose.position.y
        return message

    return changed


def _torn_pose(message: Odometry, _number: int) -> Odometry:
    """Speeds of the wheels, a pose that stands still."""
    message.pose.pose.position.x = message.pose.pose.position.y = 0.0
    return message


def _turned_tf(message: TFMessage, _number: int) -> TFMessage:
    for each in message.transforms:
        if each.child_frame_id.endswith("base_scan"):
            each.transform.rotation.z = each.transform.rotation.w = 0.5**0.5
    return message


def _second_parent(message: TFMessage, _number: int) -> TFMessage:
    twins = [copy.deepcopy(each) for each in message.transforms if each.child_frame_id == "base_footprint"]
    for each in twins:
        each.header.frame_id = "odom_filtered"
    message.transforms = [*message.transforms, *twins]
    return message


@dataclass(frozen=True)
class Break:
    """What a relay does besides passing messages on.

    Attributes:
        changes: Changes by topic.
        commands: Durability that the robot's subscription to commands asks for.
        second_lidar: Whether a second node publishes scans.
        rival: Whether a second node publishes commands.
        charge: Charge of the battery, 0 to 1.
        map_shift: Shift of the map against the pose [m]; None for no map.
    """

    changes: dict[str, Change] | None = None
    commands: DurabilityPolicy = DurabilityPolicy.VOLATILE
    second_lidar: bool = False
    rival: bool = False
    charge: float = 0.8
    map_shift: float | None = None


def _hold(_message: Any, _number: int) -> None:
    return None


BREAKS = {
    "none": Break(map_shift=0.0),
    "no scan": Break({"scan": _hold}),
    "slow scan": Break({"scan": lambda message, number: message if number % 5 == 0 else None}),
    "odometry with gaps": Break({"odom": lambda message, number: message if number % 75 < 40 else None}),
    "commands with another QoS": Break(commands=DurabilityPolicy.TRANSIENT_LOCAL),
    "clock behind": Break(dict.fromkeys(("scan", "odom", "tf"), _later(-1))),
    "clock ahead": Break(dict.fromkeys(("scan", "odom", "tf"), _later(60))),
    "no static frames": Break({"tf_static": _hold}),
    "two parents": Break({"tf": _second_parent}),
    "lidar turned in TF": Break({"tf_static": _turned_tf}),
    "covered lidar": Break({"scan": _ranges(np.zeros_like)}),
    "lost beams": Break({"scan": _ranges(_lost)}),
    "frozen lidar": Break({"scan": _frozen()}),
    "two lidars": Break(second_lidar=True),
    "odometry not finite": Break({"odom": _nan_odometry}),
    "second driver": Break(rival=True),
    "empty battery": Break(charge=0.08),
    "map of another place": Break(map_shift=0.6),
    "mirrored lidar": Break({"scan": _ranges(_mirrored)}),
    "lidar mounted turned": Break({"scan": _ranges(_quarter_turn)}),
    "swapped wheels": Break({"odom": _swapped_wheels, "tf": _in_tf(lambda odometry: _swapped_wheels(odometry, 0))}),
    "wrong wheel radius": Break({"odom": _large_wheels, "tf": _in_tf(lambda odometry: _large_wheels(odometry, 0))}),
    "pose stands still": Break({"odom": _torn_pose}),
    "motors off": Break({"cmd_vel": _hold}),
}
"""What relays break, by name."""


class Relay(Node):
    """Passes messages on, broken as one of the table says."""

    def __init__(self, how: Break) -> None:
        super().__init__("turtlebot3_node")
        self._how, self._numbers = how, dict.fromkeys(TOPICS, 0)
        self._odometry: Odometry | None = None
        self._map = self.create_publisher(OccupancyGrid, "map", LATCHED) if how.map_shift is not None else None
        self._drawn = False
        self._pass(LaserScan, "scan", "raw/scan", "scan", SCAN_PUBLISHER, SCAN_PUBLISHER)
        self._pass(Odometry, "odom", "raw/odom", "odom", ODOM_PUBLISHER, ODOM_PUBLISHER)
        self._pass(
            TwistStamped, "cmd_vel", "cmd_vel", "raw/cmd_vel", QoSProfile(depth=1, durability=how.commands), COMMAND
        )
        self._tf = self._pass(TFMessage, "tf", "/raw/tf", "/tf", QoSProfile(depth=100), QoSProfile(depth=100))
        self._pass(TFMessage, "tf_static", "/raw/tf_static", "/tf_static", LATCHED, LATCHED)
        self._battery = self.create_publisher(BatteryState, "battery_state", 10)
        self.create_timer(0.5, lambda: self._battery.publish(BatteryState(percentage=how.charge, voltage=12.0)))

    def _pass(self, kind: type, name: str, source: str, target: str, take: QoSProfile, give: QoSProfile) -> Any:
        publisher = self.create_publisher(kind, target, give)
        self.create_subscription(kind, source, partial(self._on, name, publisher), take)
        return publisher

    def _on(self, name: str, publisher: Any, message: Any) -> None:
        if name == "odom":
            self._odometry = message
            self._place_map(message)
        if name == "scan" and self._map is not None and not self._drawn and self._odometry is not None:
            self._drawn = True
            self._map.publish(draw_map(message, self._odometry))
        if name == "tf":  # a simulator may have a localisation of its own
            message.transforms = [each for each in message.transforms if each.child_frame_id != "odom"]
        change = (self._how.changes or {}).get(name)
        number, self._numbers[name] = self._numbers[name], self._numbers[name] + 1
        changed = message if change is None else change(message, number)
        if changed is not None:
            publisher.publish(changed)

    def _place_map(self, message: Odometry) -> None:
        if self._how.map_shift is not None:
            out = TransformStamped(child_frame_id="odom")
            out.header.stamp, out.header.frame_id = message.header.stamp, "map"
            out.transform.translation.x = out.transform.translation.y = self._how.map_shift
            self._tf.publish(TFMessage(transforms=[out]))


def draw_map(scan: LaserScan, odometry: Odometry) -> OccupancyGrid:
    """Return a map whose occupied cells are the echoes of a scan, seen from a pose by odometry."""
    ranges = np.frombuffer(scan.ranges, np.float32)
    bearings = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    echo = np.isfinite(ranges) & (ranges > scan.range_min)
    x, y, yaw = read_planar_pose(odometry.pose.pose).tolist()
    angles = (bearings + yaw)[echo]
    points = np.stack((np.cos(angles), np.sin(angles)), axis=1) * ranges[echo, None]
    points += (x - 0.032 * np.cos(yaw), y - 0.032 * np.sin(yaw))
    low = points.min(axis=0) - 1.0
    columns, rows = np.ceil((points.max(axis=0) + 1.0 - low) / _CELL).astype(int)
    empty = OccupancyMap(np.zeros((rows, columns), np.int8), _CELL, (float(low[0]), float(low[1]), 0.0))
    cells = empty.cells.copy()
    cells[empty.world_to_cell(points)] = OCCUPIED
    return OccupancyMap(cells, _CELL, empty.origin).to_message(scan.header.stamp, "map")


def main() -> None:
    """Relay until a signal."""
    how = BREAKS[sys.argv[1]]
    rclpy.init(args=[])
    nodes: list[Node] = [Relay(how)]
    if how.second_lidar:
        nodes.append(Node("second_lidar"))
        second = nodes[-1].create_publisher(LaserScan, "scan", SCAN_PUBLISHER)
        nodes[-1].create_subscription(LaserScan, "raw/scan", second.publish, SCAN_PUBLISHER)
    if how.rival:
        nodes.append(Node("teleop_keyboard"))
        rival = nodes[-1].create_publisher(TwistStamped, "cmd_vel", COMMAND)
        nodes[-1].create_timer(0.5, lambda: rival.publish(TwistStamped()))
    executor = rclpy.executors.SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    try:
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.5)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        executor.shutdown()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()

"""The node that listens to a robot: sensors, frames, battery, map, and the endpoints of each topic."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from ctrl_rl_core.ros import LATCHED, nanoseconds, seconds
from ctrl_rl_core.sensing import ODOMETRY_NAMES
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, LaserScan

from ctrl_rl_bringup.preflight.frames import FrameTree, Link, planar_pose, pose_matrix
from ctrl_rl_bringup.preflight.recording import Battery, Endpoint, OdometrySample, Recording, ScanSample, Times, Topic
from ctrl_rl_core import (
    CtrlRlError,
    LiveOdometry,
    OccupancyMap,
    OdometryError,
    OdometryReader,
    PoseError,
    read_planar_pose,
    read_scan,
)

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # an install by wheels that was built without it
    TFMessage = None

_ANY = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""QoS that matches every publisher and keeps bursts of messages."""
_STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_STEP_S = 0.1
_PLANAR = OdometryReader(("x", "y", "theta", "v", "omega"))
_ANOTHER_TIME_S = 3600.0
"""Stamps this far from the computer's clock are taken as simulated: /clock may be discovered last."""


class Listener(Node):
    """Records the topics of the robot that namespace and remappings select.

    Args:
        unstamped: Whether commands will be Twist instead of TwistStamped.
        command_topic: Topic that commands will be sent on.

    Attributes:
        heard: The recording so far.
    """

    def __init__(self, unstamped: bool = False, command_topic: str = "cmd_vel") -> None:
        super().__init__("preflight")
        self.heard = Recording(unstamped=unstamped, command_topic=command_topic)
        self._clock_offset, self._odometry = 0.0, LiveOdometry()
        self.create_subscription(Clock, "/clock", self._on_clock, _ANY)
        self.create_subscription(LaserScan, "scan", self._on_scan, _ANY)
        self.create_subscription(Odometry, "odom", self._on_odometry, _ANY)
        self.create_subscription(BatteryState, "battery_state", self._on_battery, _ANY)
        self.create_subscription(OccupancyGrid, "map", self._on_map, LATCHED)
        self.create_subscription(PoseWithCovarianceStamped, "amcl_pose", self._on_pose, LATCHED)
        if TFMessage is not None:
            self.heard.frames = FrameTree()
            self.create_subscription(TFMessage, "/tf", lambda message: self._on_frames(message, False), _ANY)
            self.create_subscription(TFMessage, "/tf_static", lambda message: self._on_frames(message, True), _STATIC)

    def wait(self, executor: Executor, patience: float) -> None:
        """Wait for scan, odometry and the clock of their stamps, at most some time [s]."""
        deadline = time.monotonic() + patience
        while time.monotonic() < deadline and not self._can_listen():
            executor.spin_once(timeout_sec=_STEP_S)

    def _can_listen(self) -> bool:
        heard = self.heard
        if not (heard.scans and heard.odometry):
            return False
        return heard.simulated or abs(heard.scans[-1].times.age) < _ANOTHER_TIME_S

    def listen(self, executor: Executor, duration: float, progress: Callable[[float], None]) -> Recording:
        """Record for some time [s], reporting the elapsed time [s], and return the recording."""
        heard = self.heard
        heard.scans.clear()
        heard.odometry.clear()
        heard.begin = time.monotonic()
        while time.monotonic() < heard.begin + duration:
            executor.spin_once(timeout_sec=_STEP_S)
            progress(min(duration, time.monotonic() - heard.begin))
        heard.end = time.monotonic()
        self.look_around()
        return heard

    def look_around(self) -> None:
        """Record the publishers and subscribers of each topic."""
        names = ("scan", "odom", "cmd_vel", self.heard.command_topic, "battery_state", "map", "/tf", "/tf_static")
        for name in names:
            full = self.resolve_topic_name(name)
            self.heard.topics[name] = Topic(
                full,
                self._others(self.get_publishers_info_by_topic(full)),
                self._others(self.get_subscriptions_info_by_topic(full)),
            )

    def _others(self, infos: list[Any]) -> tuple[Endpoint, ...]:
        """Return the endpoints of other programs."""
        own = self.get_fully_qualified_name()
        names = [f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos]
        return tuple(
            Endpoint(name, info.topic_type, info.qos_profile)
            for name, info in sorted(zip(names, infos, strict=True), key=lambda pair: pair[0])
            if name != own
        )

    def _now(self) -> float:
        """Return the time to compare stamps with [s]: simulated time if there is a /clock."""
        return time.monotonic() + self._clock_offset if self.heard.simulated else time.time()

    def _times(self, header: Any) -> Times:
        stamp = seconds(header.stamp)
        return Times(time.monotonic(), self._now() - stamp, stamp)

    def _on_clock(self, message: Clock) -> None:
        heard = self.heard
        if not heard.simulated:  # ages of what came before were held to the wrong clock
            heard.simulated, heard.begin = True, time.monotonic()
            heard.scans.clear()
            heard.odometry.clear()
        self._clock_offset = seconds(message.clock) - time.monotonic()

    def _on_scan(self, message: LaserScan) -> None:
        ranges, geometry = read_scan(message)
        times, frame = self._times(message.header), message.header.frame_id
        self.heard.scans.append(ScanSample(times, frame, ranges.copy(), geometry))

    def _on_odometry(self, message: Odometry) -> None:
        fault = ""
        try:
            odometry = self._odometry.read(message)
        except OdometryError as error:
            odometry, fault = np.full(len(ODOMETRY_NAMES), np.nan), str(error)
        x, y, yaw, v, omega = _PLANAR(odometry).tolist()
        frames = message.header.frame_id, message.child_frame_id
        self.heard.odometry.append(OdometrySample(self._times(message.header), *frames, (x, y, yaw), (v, omega), fault))

    def _on_battery(self, message: BatteryState) -> None:
        percentage = float(message.percentage)  # 0 to 1 by its definition, 0 to 100 by some drivers
        self.heard.battery = Battery(percentage / 100.0 if percentage > 1.0 else percentage, float(message.voltage))

    def _on_map(self, message: OccupancyGrid) -> None:
        try:
            self.heard.map = (message.header.frame_id, OccupancyMap.from_message(message))
            self.heard.map_fault = ""
        except CtrlRlError as error:
            self.heard.map, self.heard.map_fault = None, str(error)

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        try:
            x, y, yaw = read_planar_pose(message.pose.pose).tolist()
        except PoseError:
            return  # `check_map` then says that there is no pose
        self.heard.map_pose = message.header.frame_id, (x, y, yaw)

    def _on_frames(self, message: Any, static: bool) -> None:
        tree = self.heard.frames
        if tree is None:
            return
        for each in message.transforms:
            moved, turned = each.transform.translation, each.transform.rotation
            matrix = pose_matrix((moved.x, moved.y, moved.z), (turned.x, turned.y, turned.z, turned.w))
            if matrix is None:
                continue  # its frame then hangs in no tree, and `check_tree` says so
            age = float("nan") if static else self._now() - seconds(each.header.stamp)
            parent, child = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
            tree.add(Link(parent, child, matrix, age, static))
            yaw, stamp = planar_pose(matrix)[2], nanoseconds(each.header.stamp)
            tree.conflicts.note(parent, child, matrix[:3, 3], yaw, stamp, time.monotonic(), static)
            tree.conflict = tree.conflict or tree.conflicts.any_fault(time.monotonic())

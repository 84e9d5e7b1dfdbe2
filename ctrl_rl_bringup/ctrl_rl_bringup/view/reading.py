"""Fills a `Scene` from messages, whether they come from topics or from a bag."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from ctrl_rl_core.navigation import Transform, TransformError, TransformTree
from ctrl_rl_core.ros import nanoseconds
from ctrl_rl_core.sensing import view_scan
from numpy.typing import NDArray

from ctrl_rl_bringup.view.scene import Array, Escape, Grid, Pose, Scene, Surface
from ctrl_rl_core import CtrlRlError, OccupancyMap, Robot, read_odometry, read_scan
from ctrl_rl_msgs.msg import NavigatorStatus, SafetyStatus

_MOST_POSES = 5000
"""Number of a path's poses, and of an escape's points, that are shown."""
_NOWHERE = Transform.planar(0.0, 0.0, 0.0)
_FILTER_FINE = (SafetyStatus.PASSED,)
_DRIVES = (NavigatorStatus.SOLVING, NavigatorStatus.DRIVING, NavigatorStatus.BLOCKED)
_BAD = (NavigatorStatus.UNREACHABLE, NavigatorStatus.BLOCKED)
_FILTER_MODES = {
    getattr(SafetyStatus, name): name.lower()
    for name in ("WAITING", "PASSED", "CORRECTED", "ESCAPING", "UNBLOCKING", "EVADING")
}


class SceneReader:
    """Reads messages into a scene.

    Args:
        scene: Scene to fill.
        robot: Robot, for the mounting of its lidar.
        map_frame: Frame of the map.
        slices: Whether the navigator's slice is shown; not if a value file is.

    Attributes:
        TOPICS: Methods by relative topic name; names that begin with / are absolute.
    """

    def __init__(self, scene: Scene, robot: Robot, map_frame: str, slices: bool = True) -> None:
        self._scene, self._lidar, self._map_frame, self._slices = scene, robot.lidar, map_frame, slices
        self._tree, self._base, self._odometry = TransformTree(), "", _NOWHERE
        self._filter_answers = False

    def forget(self) -> None:
        """Forget transforms, so that the time may go backwards."""
        self._tree, self._base = TransformTree(), ""

    def take(self, topic: str, message: Any, now: float) -> None:
        """Read one message; what is wrong with it is noted in the scene.

        Args:
            topic: Key of `TOPICS`.
            message: Message, from rclpy or a bag.
            now: Steady time [s].
        """
        try:
            self.TOPICS[topic](self, message, now)
        except CtrlRlError as error:
            self._scene.say(topic, str(error), 2)
        else:
            if topic in self._scene.notes:
                self._scene.say(topic, "")

    def update_pose(self) -> None:
        """Bring the robot's pose up to date; without transforms it is that of the odometry."""
        if not self._base:
            return
        try:
            found = self._tree.lookup(self._map_frame, self._base)
            self._scene.say("pose", "")
        except TransformError as error:
            found = self._odometry
            self._scene.say("pose", f"that of the odometry: {error}", 1)
        self._scene.pose = _pose(found)

    def _place(self, frame: str, stamp: int | None = None) -> Transform:
        """Return the pose of a frame in the map frame, at a time [ns] if it is known."""
        frame = frame.lstrip("/")
        if frame in ("", self._map_frame):
            return _NOWHERE
        for when in (stamp, None):
            try:
                return self._tree.lookup(self._map_frame, frame, when)
            except TransformError:
                continue
        return self._odometry if frame == self._base else _NOWHERE

    def _on_moving(self, message: Any, now: float) -> None:
        self._tree.update(message, now)

    def _on_fixed(self, message: Any, now: float) -> None:
        self._tree.update(message, now, fixed=True)

    def _on_odometry(self, message: Any, _now: float) -> None:
        odometry = read_odometry(message)
        self._base = message.child_frame_id.lstrip("/") or "base_footprint"
        self._odometry = Transform(odometry[:3], odometry[3:7])

    def _on_scan(self, message: Any, _now: float) -> None:
        ranges, geometry = read_scan(message, self._lidar.yaw)
        points = view_scan(ranges, geometry, math.inf, self._lidar.x).points
        points[:, 1] += self._lidar.y
        if self._base:
            self._scene.scan = _placed(points, self._place(self._base, nanoseconds(message.header.stamp)))

    def _on_map(self, message: Any, _now: float) -> None:
        new, old = OccupancyMap.from_message(message), self._scene.map
        if old is None or not new.is_same(old):
            self._scene.map = new

    def _on_path(self, message: Any, _now: float) -> None:
        places = [(pose.pose.position.x, pose.pose.position.y) for pose in message.poses[:_MOST_POSES]]
        self._scene.path = _placed(_finite(places), self._place(message.header.frame_id))

    def _on_slice(self, message: Any, _now: float) -> None:
        if self._slices:
            grid = _grid(message, self._place(message.header.frame_id))
            heights = np.where(grid.percent < 0, np.nan, 0.01 * grid.percent)
            x, y, yaw = grid.origin
            half, c, s = 0.5 * grid.cell, math.cos(yaw), math.sin(yaw)
            self._scene.value = Surface(heights, grid.cell, (x + half * (c - s), y + half * (s + c), yaw))

    def _on_set(self, message: Any, _now: float) -> None:
        self._scene.safe_set = _grid(message, self._place(message.header.frame_id))

    def _on_escape(self, message: Any, _now: float) -> None:
        points = _finite([(point.x, point.y) for point in message.points[:_MOST_POSES]])
        colour = float(message.color.r), float(message.color.g), float(message.color.b)
        placed = _placed(points, self._place(message.header.frame_id))
        self._scene.escape = Escape(placed, colour) if len(placed) > 1 else None

    def _on_navigator(self, message: Any, _now: float) -> None:
        position = message.goal.position
        driving = message.state in _DRIVES and math.isfinite(position.x + position.y)
        self._scene.goal = (float(position.x), float(position.y)) if driving else None
        left = f" ({message.remaining_time:.0f} s to go)" if math.isfinite(message.remaining_time) and driving else ""
        self._scene.say("navigator", f"{message.message}{left}", 1 if message.state in _BAD else 0)

    def _on_filter(self, message: Any, _now: float) -> None:
        self._filter_answers = True
        self._scene.raw = _command(message.raw_speed, message.raw_turn_rate)
        self._scene.sent = _command(message.speed, message.turn_rate)
        mode = _FILTER_MODES.get(message.mode, str(message.mode))
        words = f"{mode}: {message.why}" if message.why else mode
        self._scene.say("safety filter", words, 0 if message.mode in _FILTER_FINE else 1)

    def _on_raw(self, message: Any, _now: float) -> None:
        if not self._filter_answers:
            self._scene.raw = _twist(message)

    def _on_sent(self, message: Any, _now: float) -> None:
        if not self._filter_answers:
            self._scene.sent = _twist(message)

    def _on_latent(self, message: Any, _now: float) -> None:
        figures = f"distance from training {message.distance:.2f}, one-step error {message.prediction_error:.3f}"
        self._scene.say("latent state", message.stop or f"{figures}, cost to go {message.cost_to_go:.1f}")

    def _on_diagnostics(self, message: Any, _now: float) -> None:
        for status in message.status:
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            self._scene.say(status.name, status.message, level)

    TOPICS: ClassVar[dict[str, Callable[[SceneReader, Any, float], None]]] = {
        "/tf": _on_moving,
        "/tf_static": _on_fixed,
        "/diagnostics": _on_diagnostics,
        "odom": _on_odometry,
        "scan": _on_scan,
        "map": _on_map,
        "path": _on_path,
        "cmd_vel_raw": _on_raw,
        "cmd_vel": _on_sent,
        "navigator/slice": _on_slice,
        "navigator/status": _on_navigator,
        "safety_filter/set": _on_set,
        "safety_filter/escape": _on_escape,
        "safety_filter/status": _on_filter,
        "koopman_lqr_controller/latent": _on_latent,
    }


def _grid(message: Any, frame: Transform) -> Grid:
    """Read the numbers of a nav_msgs/OccupancyGrid, which need not be a map.

    Raises:
        CtrlRlError: The message is inconsistent, or a number is out of range.
    """
    checked = OccupancyMap.from_message(message)  # of sizes and numbers; its cells are rounded to free and occupied
    percent: NDArray[np.int8] = np.array(message.data, np.int8).reshape(checked.cells.shape)
    x, y, yaw = checked.origin
    return Grid(percent, checked.resolution, _pose(frame @ Transform.planar(x, y, yaw)))


def _pose(transform: Transform) -> Pose:
    x, y, yaw = transform.pose.tolist()
    return x, y, yaw


def _finite(places: list[tuple[float, float]]) -> Array:
    points = np.array(places, np.float64).reshape(-1, 2)
    return points[np.isfinite(points).all(axis=1)]


def _placed(points: Array, frame: Transform) -> Array:
    """Return points (n, 2) of a frame in the frame of the map (n, 2) [m]."""
    x, y, yaw = frame.pose.tolist()
    c, s = math.cos(yaw), math.sin(yaw)
    return np.column_stack((x + c * points[:, 0] - s * points[:, 1], y + s * points[:, 0] + c * points[:, 1]))


def _twist(message: Any) -> tuple[float, float] | None:
    twist = getattr(message, "twist", message)  # TwistStamped or Twist
    return _command(twist.linear.x, twist.angular.z)


def _command(speed: float, turn_rate: float) -> tuple[float, float] | None:
    return (float(speed), float(turn_rate)) if math.isfinite(speed) and math.isfinite(turn_rate) else None

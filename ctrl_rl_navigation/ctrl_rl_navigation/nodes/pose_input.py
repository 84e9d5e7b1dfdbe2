"""The pose of the robot in the map from the node's topics, and the last echoes as the robot sees them now."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from ctrl_rl_core.driving.scan import ScanError, view_scan
from ctrl_rl_core.navigation.pose_source import LocaliserPose, OdometryTrack, PoseSource, TransformPose
from ctrl_rl_core.navigation.transform_tree import Transform, TransformError, TransformTree
from ctrl_rl_core.ros.node import SENSOR
from geometry_msgs.msg import PoseWithCovarianceStamped
from numpy.typing import NDArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from ctrl_rl_core import LidarVelocityNode, ScanGeometry

_TF = QoSProfile(depth=100)
_STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of several publishers, each of which sends its transforms once."""
_NOWHERE = Transform.planar(0.0, 0.0, 0.0)

Array = NDArray[np.float64]


class PoseInput:
    """Subscribes to what tells the pose.

    Attributes:
        track: Poses by odometry.
        refused: Reason why the last wrong message was refused; empty where none was.
    """

    def __init__(self, node: LidarVelocityNode, now: Callable[[], float]) -> None:
        self._now = now
        self.track = OdometryTrack()
        self.refused = ""
        self._echoes, self._seen_from = np.empty((0, 2)), _NOWHERE
        settings = node.settings
        self._map_frame: str = settings["map_frame"]
        if settings["pose"] == "amcl_pose":
            localiser = LocaliserPose(self.track, self._map_frame, node.timeout)
            node.create_subscription(
                PoseWithCovarianceStamped, "amcl_pose", lambda message: self._try(localiser.on_pose, message), SENSOR
            )
            self._source: PoseSource = localiser
            return
        tree = TransformTree()
        self._source = TransformPose(tree, self._map_frame, settings["pose_timeout"])
        for topic, profile, fixed in (("/tf", _TF, False), ("/tf_static", _STATIC, True)):
            node.create_subscription(
                TFMessage, topic, lambda message, fixed=fixed: self._on_transforms(tree, message, fixed), profile
            )

    def on_odometry(self, message: Any, base_frame: str) -> None:
        """Take odometry, and the frame of the robot that it or a parameter names."""
        self._try(lambda odometry: self.track.update(odometry, self._now()), message)
        if isinstance(self._source, TransformPose):
            self._source.base = base_frame

    def on_scan(self, stamp: int, ranges: NDArray[np.float32], scan: ScanGeometry, lidar_x: float) -> bool:
        """Take a scan of a stamp [ns] and return whether it can be used."""
        try:
            self._echoes = view_scan(ranges, scan, math.inf, lidar_x).points
            self._seen_from = self.track.at(stamp)
        except ScanError:
            return False
        except TransformError:  # clocks of scan and odometry differ: as if it were of now
            self._seen_from = self.track.latest() if self.track.heard > -math.inf else _NOWHERE
        return True

    def pose(self) -> Array:
        """Return the pose in the map (3,) [m, m, rad].

        Raises:
            TransformError: It is unknown, or too old.
        """
        return self._source.pose(self._now())

    def seen(self, pose: Array) -> tuple[Array, Array]:
        """Return the pose (3,) in the map from which the last scan was taken, and its echoes there (n, 2) [m]."""
        return (Transform.planar(*pose.tolist()) @ self._since()).pose, self._echoes

    def echoes(self) -> Array:
        """Return the echoes of the last scan in the robot's frame of now (n, 2) [m]."""
        x, y, yaw = self._since().pose.tolist()
        c, s = math.cos(yaw), math.sin(yaw)
        return self._echoes @ np.array(((c, s), (-s, c))) + (x, y)

    def frame_in_map(self, frame: str) -> Transform:
        """Return the pose of a frame in the map's; an empty name is that of the map.

        Raises:
            TransformError: The frame is unknown.
        """
        frame = frame.lstrip("/")
        return _NOWHERE if frame in ("", self._map_frame) else self._source.frame_in_map(frame)

    def _since(self) -> Transform:
        """Return the pose of the last scan in the robot's frame of now."""
        if self.track.heard == -math.inf:
            return _NOWHERE
        return self.track.latest().inverse() @ self._seen_from

    def _on_transforms(self, tree: TransformTree, message: TFMessage, fixed: bool) -> None:
        self.refused = tree.update(message, self._now(), fixed) or self.refused

    def _try(self, take: Callable[[Any], None], message: Any) -> None:
        try:
            take(message)
        except TransformError as error:
            self.refused = str(error)

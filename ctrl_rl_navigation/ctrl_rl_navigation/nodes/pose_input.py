"""The pose of the robot in the map from the node's topics, and the last echoes as the robot sees them now."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from ctrl_rl_core.navigation.transform_tree import Transform, TransformError
from ctrl_rl_core.policies.pose_input import PoseInput
from ctrl_rl_core.sensing.scan import ScanError, view_scan
from numpy.typing import NDArray

from ctrl_rl_core import LidarVelocityNode, ScanGeometry

_NOWHERE = Transform.planar(0.0, 0.0, 0.0)

Array = NDArray[np.float64]


class SeenPoseInput(PoseInput):
    """Subscribes to what tells the pose in the map, and knows from where the last scan was taken."""

    def __init__(self, node: LidarVelocityNode, now: Callable[[], float]) -> None:
        super().__init__(node, node.timeout, now)
        self._map_frame: str = node.settings["map_frame"]
        self._echoes, self._seen_from = np.empty((0, 2)), _NOWHERE

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

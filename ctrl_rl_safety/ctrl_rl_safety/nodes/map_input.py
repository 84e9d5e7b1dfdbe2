"""The map, where there is one: what is on it stands for ever, and everything else may move."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from ctrl_rl_core.navigation.transform_tree import Transform, TransformError
from ctrl_rl_core.policies.pose_input import PoseInput
from ctrl_rl_core.ros.node import LATCHED
from nav_msgs.msg import OccupancyGrid, Odometry
from numpy.typing import NDArray

from ctrl_rl_core import CtrlRlError, OccupancyMap, SuiteNode

Array = NDArray[np.float64]
Fixed = Callable[[Array], NDArray[np.bool_]]

NEAR = 0.1
"""Distance from an occupied cell up to which an echo counts as that of the map [m]."""
_OCCUPIED = 100


class MapInput:
    """Subscribes to the map, and to the pose on it.

    Attributes:
        problem: Reason why the map is not used; empty while it is.
    """

    def __init__(self, node: SuiteNode, timeout: float, now: Callable[[], float]) -> None:
        """Subscribe.

        Args:
            node: Node with the parameters `POSE_PARAMETERS`.
            timeout: Age of odometry from which on it is too old [s].
            now: Returns steady time, or that of the simulation [s].
        """
        self._logger, self._frame = node.get_logger(), node.settings["map_frame"]
        self._pose = PoseInput(node, timeout, now)
        self._map: OccupancyMap | None = None
        self._near: NDArray[np.bool_] = np.zeros((0, 0), np.bool_)
        self.problem = "no map yet"
        node.create_subscription(OccupancyGrid, "map", self._on_map, LATCHED)

    def on_odometry(self, message: Odometry, base: str) -> None:
        """Take odometry, and the frame of the robot."""
        self._pose.on_odometry(message, base)

    def fixed(self, pose: Array) -> Fixed | None:
        """Return a function that says which places (n, 2) of the odometry's frame [m] the map has (n,).

        Args:
            pose: Pose by odometry (3,) [m, m, rad].

        Returns:
            The function; None without a map and a pose on it.
        """
        map_, near = self._map, self._near
        if map_ is None:
            return None
        try:
            there = self._pose.pose()
        except TransformError as error:
            self.problem = str(error)
            return None
        x, y, yaw = (Transform.planar(*there.tolist()) @ Transform.planar(*pose.tolist()).inverse()).pose.tolist()
        c, s = math.cos(yaw), math.sin(yaw)
        self.problem = ""

        def on_map(points: Array) -> NDArray[np.bool_]:
            rows, columns = map_.world_to_cell(points @ np.array(((c, s), (-s, c))) + (x, y))
            inside = (rows >= 0) & (rows < near.shape[0]) & (columns >= 0) & (columns < near.shape[1])
            out = np.zeros(len(points), np.bool_)
            out[inside] = near[rows[inside], columns[inside]]
            return out

        return on_map

    def _on_map(self, message: OccupancyGrid) -> None:
        frame = message.header.frame_id.lstrip("/")
        if frame not in ("", self._frame):
            self._logger.warning(f"a map in frame '{frame}' is not used: parameter 'map_frame' names another")
            return
        try:
            map_ = OccupancyMap.from_message(message)
        except CtrlRlError as error:
            self._logger.error(f"the map is not used: {error}")
            return
        self._near, self._map = _near(map_.cells == _OCCUPIED, math.ceil(NEAR / map_.resolution)), map_
        self._logger.info(f"a map of {map_.size[0]:.1f} x {map_.size[1]:.1f} m: what is on it stands")


def _near(occupied: NDArray[np.bool_], cells: int) -> NDArray[np.bool_]:
    """Return which cells (rows, columns) have an occupied one within a square of so many cells to each side."""
    out = occupied
    for axis in (0, 1):
        before = np.pad(out, [(cells, cells) if each == axis else (0, 0) for each in (0, 1)])
        count = out.shape[axis]
        out = np.logical_or.reduce([before.take(range(k, k + count), axis) for k in range(2 * cells + 1)])
    return np.asarray(out)

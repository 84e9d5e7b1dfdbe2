"""Input of the optional map, whose obstacles never move."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from ctrl_rl_core.navigation import TransformError
from ctrl_rl_core.policies import PoseInput
from ctrl_rl_core.ros import LATCHED
from nav_msgs.msg import OccupancyGrid, Odometry
from numpy.typing import NDArray

from ctrl_rl_core import CtrlRlError, OccupancyMap, SuiteNode
from ctrl_rl_safety.filter.map_walls import Fixed, MapWalls

Array = NDArray[np.float64]


class MapInput:
    """Subscribes to the map, and to the robot's pose on it.

    Attributes:
        problem: Reason why the map is not used; empty if it is used.
    """

    def __init__(self, node: SuiteNode, timeout: float, now: Callable[[], float]) -> None:
        """Subscribe.

        Args:
            node: Node with the parameters `POSE_PARAMETERS`.
            timeout: Maximum age of odometry [s].
            now: Returns the steady or simulated time [s].
        """
        self._logger, self._frame = node.get_logger(), node.settings["map_frame"]
        self._pose = PoseInput(node, timeout, now)
        self._walls: MapWalls | None = None
        self.problem = "no map yet"
        node.create_subscription(OccupancyGrid, "map", self._on_map, LATCHED)

    def on_odometry(self, message: Odometry, base: str) -> None:
        """Process odometry and the robot's frame."""
        self._pose.on_odometry(message, base)

    def fixed(self, pose: Array) -> Fixed | None:
        """Return a function that returns which positions (n, 2) in the odometry frame [m] are on the map (n,).

        Args:
            pose: Odometry pose (3,) [m, m, rad].

        Returns:
            The function; None without a map and a pose on it.
        """
        walls = self._walls
        if walls is None:
            return None
        try:
            there = self._pose.pose()
        except TransformError as error:
            self.problem = str(error)
            return None
        self.problem = ""
        return walls.fixed(there, pose)

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
        self._walls = MapWalls(map_)
        self._logger.info(f"a map of {map_.size[0]:.1f} x {map_.size[1]:.1f} m: what is on it never moves")

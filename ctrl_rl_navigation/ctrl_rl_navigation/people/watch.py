"""Tracks movers from the sensors of a robot, and tells where they are on the map."""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.navigation import Transform
from ctrl_rl_core.sensing import measured, planar
from numpy.typing import NDArray

from ctrl_rl_core import Sensors
from ctrl_rl_navigation.people.movers import advanced, placed
from ctrl_rl_navigation.people.tracker import Tracker

Array = NDArray[np.float64]

_FARTHEST = 12.0
"""Length of a beam without an echo, whatever the lidar claims [m]."""
_UNMEASURED = 1e-3
"""Length of a beam that measured nothing [m]."""


class Watch:
    """A tracker in the frame of odometry, which does not jump as the pose on a map does.

    Args:
        lidar_x: Position of the lidar ahead of the robot's centre [m].
    """

    def __init__(self, lidar_x: float) -> None:
        self._lidar_x, self._tracker, self._seen_at = lidar_x, Tracker(), -math.inf

    def see(self, sensors: Sensors) -> NDArray[np.bool_]:
        """Process a scan, and return which of its echoes are those of movers (number of echoes,)."""
        ranges, scan = measured(sensors.ranges, sensors.scan), sensors.scan
        x, y, yaw = planar(sensors.odometry[:7].tolist()).tolist()
        bearings = yaw + scan.angle_min + scan.angle_increment * np.arange(scan.beams)
        reached = np.minimum(np.where(np.isnan(ranges), _UNMEASURED, ranges), min(_FARTHEST, scan.range_max))
        origin = np.array((x + self._lidar_x * math.cos(yaw), y + self._lidar_x * math.sin(yaw)))
        ends = origin + reached[:, None] * np.column_stack((np.cos(bearings), np.sin(bearings)))
        self._seen_at = sensors.time
        return self._tracker.update(sensors.time, origin, ends, np.isfinite(ranges), yaw)

    def movers(self, sensors: Sensors) -> Array:
        """Return the predictions of all movers in the frame of the sensors' pose (m, 12), at their time."""
        rows = self._tracker.movers()
        if not len(rows) or sensors.pose is None:
            return rows[:0]
        odometry = Transform.planar(*planar(sensors.odometry[:7].tolist()).tolist())
        map_frame = odometry @ Transform.planar(*sensors.pose.tolist()).inverse()
        x, y, yaw = map_frame.pose.tolist()
        return placed(advanced(rows, sensors.time - self._seen_at), x, y, yaw)

"""Sensor readings at the time of a scan, as arrays, from a live node, a simulator or a bag."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.sensing.odometry import OMEGA_Z, V
from ctrl_rl_core.sensing.scan import ScanGeometry

Array = NDArray[np.float64]


class Sensors(NamedTuple):
    """Sensor readings at the time of a scan.

    Attributes:
        ranges: Ranges of the scan's beams (beams,) [m].
        scan: Bearings and limits of the beams in the robot's frame.
        odometry: Latest odometry (13,), see `ODOMETRY_NAMES`.
        pose: Pose x, y, theta (3,) [m, m, rad]; None if unknown.
        goal: Goal x, y, theta in the frame of the pose (3,) [m, m, rad]; None without a goal.
        command: Last command sent (2,).
        time: Time of the odometry, on the robot's clock [s].
        age: Age of the scan at that time [s]; 0 for a scan taken at that time.
    """

    ranges: NDArray[np.float32]
    scan: ScanGeometry
    odometry: Array
    pose: Array | None
    goal: Array | None
    command: Array
    time: float = 0.0
    age: float = 0.0

    @property
    def speeds(self) -> tuple[float, float]:
        """Forward speed [m/s] and turn rate [rad/s] from odometry of a wheeled robot."""
        return float(self.odometry[V]), float(self.odometry[OMEGA_Z])

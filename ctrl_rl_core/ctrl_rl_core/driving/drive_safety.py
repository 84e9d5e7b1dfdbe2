"""What a robot may do by its last scan: the scan's health, the gaps in it and the obstacles, taken together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.driving.obstacle_stop import ObstacleStop
from ctrl_rl_core.driving.scan import ScanError, ScanGeometry, ScanView, view_scan
from ctrl_rl_core.driving.scan_health import ScanHealth, lidar_identity

Array = NDArray[np.float64]


class DriveSafety:
    """Takes scans, and says which part of a command is safe.

    Args:
        health: checks of the scans.
        obstacles: room that the robot needs.
        forward: where the lidar sits, ahead of the robot's middle [m].
        reach: echoes that are farther from the lidar cannot stop the robot [m].

    Attributes:
        reach: echoes that are farther from the lidar cannot stop the robot [m].
        view: the last scan, None where it is none.
        unfit: why the last scan allows no command at all, empty where it does.
    """

    def __init__(self, health: ScanHealth, obstacles: ObstacleStop, forward: float, reach: float) -> None:
        self.view: ScanView | None = None
        self.fault = "no scan yet"
        self._health, self._obstacles = health, obstacles
        self._forward, self.reach = forward, reach

    def set_checks(self, health: ScanHealth, obstacles: ObstacleStop, reach: float) -> None:
        """Check otherwise from the next scan on."""
        self._health, self._obstacles, self.reach = health, obstacles, reach

    def update(
        self,
        now: float,
        stamp: int,
        frame: str,
        ranges: NDArray[np.float32],
        scan: ScanGeometry,
        motion: tuple[float, float],
    ) -> None:
        """Take a scan.

        Args:
            now: steady time [s].
            stamp: time stamp of the scan [ns].
            frame: frame of the scan.
            ranges: ranges (scan.beams,) [m].
            scan: their geometry in the robot's frame.
            motion: speed [m/s] and turn rate [rad/s] by odometry.
        """
        try:
            self.view = view_scan(ranges, scan, self.reach, self._forward)
        except ScanError as error:
            self.view, self.fault = None, str(error)
            return
        identity = lidar_identity(frame, scan)
        self.fault = self._health.update(now, self.view, ranges.tobytes(), stamp, identity, motion)

    def limit(self, command: Array, v: float, age: float) -> tuple[Array, str]:
        """Return what is safe of a command (2,), and why that is not all of it, empty where it is.

        Args:
            command: speed [m/s] and turn rate [rad/s] (2,).
            v: speed by odometry [m/s].
            age: age of the last scan [s].

        Raises:
            ScanError: the last scan says nothing of where the command leads: the robot must stand.
        """
        if not command.any():
            return command, ""
        if self.fault or self.view is None:
            raise ScanError(self.fault)
        problem = self._health.blind(self.view, float(command[0]))
        if problem:
            raise ScanError(problem)
        return self._obstacles.limit(command, self.view.points, v, age)

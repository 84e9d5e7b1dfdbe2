"""Limits a command by the last scan: by its health, its gaps, and the obstacles in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.driving.obstacle_stop import ObstacleStop
from ctrl_rl_core.sensing.scan import ScanError, ScanGeometry, ScanView, view_scan
from ctrl_rl_core.sensing.scan_health import ScanHealth, lidar_identity
from ctrl_rl_core.sensing.sensors import Sensors

Array = NDArray[np.float64]


class DriveSafety:
    """Checks each scan, and limits commands to their safe part; of sensors it is a `Filter`.

    Args:
        health: Checks of the scans.
        obstacles: Braking distance and size of the robot.
        forward: Position of the lidar ahead of the robot's middle [m].
        reach: Distance from the lidar beyond which echoes are ignored [m].

    Attributes:
        reach: Distance from the lidar beyond which echoes are ignored [m].
        view: Echoes of the last scan; None where it is unusable.
        fault: Reason why the last scan allows no motion; empty where it does.
    """

    def __init__(self, health: ScanHealth, obstacles: ObstacleStop, forward: float, reach: float) -> None:
        self.view: ScanView | None = None
        self.fault = "no scan yet"
        self._health, self._obstacles = health, obstacles
        self._forward, self.reach = forward, reach

    def set_checks(self, health: ScanHealth, obstacles: ObstacleStop, reach: float) -> None:
        """Replace the checks from the next scan on."""
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
            now: Steady time [s].
            stamp: Time stamp of the scan [ns].
            frame: Frame of the scan.
            ranges: Ranges (scan.beams,) [m].
            scan: Bearings and limits of the beams in the robot's frame.
            motion: Speed [m/s] and turn rate [rad/s] by odometry.
        """
        try:
            self.view = view_scan(ranges, scan, self.reach, self._forward)
        except ScanError as error:
            self.view, self.fault = None, str(error)
            return
        identity = lidar_identity(frame, scan)
        self.fault = self._health.update(now, self.view, ranges.tobytes(), stamp, identity, motion)

    def __call__(self, sensors: Sensors, command: Array) -> Array:
        """Return the safe part of a command (2,); zeros where the scan allows no motion in its direction."""
        v, omega = sensors.speeds
        if sensors.age == 0.0:
            self.update(sensors.time, round(1e9 * sensors.time), "scan", sensors.ranges, sensors.scan, (v, omega))
        try:
            return self.limit(command, v, sensors.age)[0]
        except ScanError:
            return np.zeros(2)

    def limit(self, command: Array, v: float, age: float) -> tuple[Array, str]:
        """Return the safe part of a command (2,), and the reason where it is less than the whole.

        Args:
            command: Speed [m/s] and turn rate [rad/s] (2,).
            v: Speed by odometry [m/s].
            age: Age of the last scan [s].

        Raises:
            ScanError: The last scan does not cover the direction of the command, so the robot must stop.
        """
        if not command.any():
            return command, ""
        if self.fault or self.view is None:
            raise ScanError(self.fault)
        problem = self._health.blind(self.view, float(command[0]))
        if problem:
            raise ScanError(problem)
        return self._obstacles.limit(command, self.view.points, v, age)

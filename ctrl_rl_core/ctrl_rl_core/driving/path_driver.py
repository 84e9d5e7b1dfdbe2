"""Drives along a path by any driver: one that keeps to the middle of a corridor by its scan, or one with a goal."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.driving.commander import VelocityError
from ctrl_rl_core.driving.drive import Driver
from ctrl_rl_core.driving.path_view import PathView
from ctrl_rl_core.sensing.scan import Sensors

Array = NDArray[np.float64]

_GOAL_AHEAD = 1.0
"""Distance along the path of the goal that a driver gets [m]."""
_HEADING_AHEAD = 0.3
"""Distance along the path of the place that the robot turns to [m]."""
_TURN_FROM, _TURN_TO = 1.2, 0.3
"""Angle to the path above which the robot turns on the spot, and at which it drives on [rad]."""
_LOST = 2.0
"""Distance from the path, in half widths of the corridor, beyond which the path is lost."""


class PathDriver:
    """Shows a driver the path as a corridor, and stops at its end.

    Args:
        driver: Driver that keeps to the middle of corridors, or drives to the goal in its sensors.
        path: Positions in the frame of the poses (n, 2) [m].
        half_width: Half width of the corridor that the driver sees [m].
        tolerance: Distance along the path from its end at which it is reached [m].
        turn_rate: Rate of turns on the spot [rad/s].
        deceleration: Deceleration before the end [m/s^2].
        lidar_x: Position of the lidar ahead of the robot's centre [m].

    Attributes:
        view: The path and the robot's place on it.
        arrived: Whether the end is reached.
    """

    def __init__(
        self,
        driver: Driver[Sensors],
        path: Array,
        half_width: float,
        tolerance: float,
        turn_rate: float,
        deceleration: float,
        lidar_x: float = 0.0,
    ) -> None:
        self._driver, self._half_width, self._tolerance, self._lidar_x = driver, half_width, tolerance, lidar_x
        self._turn_rate, self._deceleration = turn_rate, deceleration
        self.view = PathView(path, half_width)
        self.arrived = self._turning = False

    def command(self, sensors: Sensors) -> Array:
        """Return the command (2,); zeros at the end of the path.

        Raises:
            CtrlRlError: The pose is unknown, the path is lost, or the driver has no command.
        """
        pose, view = sensors.pose, self.view
        if pose is None:
            raise VelocityError("a path needs a pose")
        view.update(pose)
        self.arrived |= view.left <= self._tolerance
        if self.arrived:
            return np.zeros(2)
        if view.beside > _LOST * self._half_width:
            raise VelocityError(f"the robot is {view.beside:.2f} m from the path")
        turn = self._turn(pose)
        if self._turning:
            return np.array((0.0, math.copysign(min(self._turn_rate, 2.0 * abs(turn)), turn)))
        ranges = view.corridor(sensors.ranges, sensors.scan, pose, self._lidar_x)
        command = self._driver.command(sensors._replace(ranges=ranges, goal=view.ahead(_GOAL_AHEAD)))
        fastest = math.sqrt(2.0 * self._deceleration * view.left)
        return command * min(1.0, fastest / max(abs(float(command[0])), 1e-9))

    def _turn(self, pose: Array) -> float:
        """Return the angle to the path ahead [rad], and note whether to turn on the spot first."""
        x, y, heading = self.view.ahead(_HEADING_AHEAD).tolist()
        if self.view.beside > 0.5 * self._half_width:  # back to it, not parallel to it
            heading = math.atan2(y - pose[1], x - pose[0])
        turn = math.remainder(heading - float(pose[2]), 2.0 * math.pi)
        self._turning = abs(turn) > (_TURN_TO if self._turning else _TURN_FROM)
        return turn

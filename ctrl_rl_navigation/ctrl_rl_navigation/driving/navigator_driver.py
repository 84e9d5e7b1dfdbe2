"""The navigator as a `Driver`, for its node and for in-process simulation; sensors must include a pose on the map."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from ctrl_rl_core.navigation import Transform
from ctrl_rl_core.sensing import measured, planar, view_scan
from numpy.typing import NDArray

from ctrl_rl_core import ScanError, ScanGeometry, Sensors
from ctrl_rl_navigation.driving.decision import Decision, NavigatorState
from ctrl_rl_navigation.people import Watch

Array = NDArray[np.float64]

_STAND = np.zeros(2)
_NOWHERE = Transform.planar(0.0, 0.0, 0.0)
_FARTHEST = 100.0
"""Length of a beam without an echo, whatever the lidar claims [m]."""


class Decider(Protocol):
    """What a driver asks for commands: `Navigator`, or the navigator of a car."""

    def sent(self, command: Array) -> None:
        """Record the command actually sent (2,)."""

    def poll(self, now: float) -> None:
        """Process finished background work at a steady time [s]."""

    def see(self, now: float, pose: Array, points: Array, empty: Array) -> None:
        """Process a scan, see `Navigator.see`."""

    def decide(self, now: float, pose: Array, points: Array, movers: Array) -> Decision:
        """Return the decision for this period, see `Navigator.decide`."""


class NavigatorDriver:
    """Passes scans with their poses to a navigator, and requests commands from it.

    Args:
        navigator: Decider, with or without a map and a goal.
        lidar_x: Position of the lidar ahead of the robot's centre [m].
        reach: Distance from the robot within which echoes are used [m].

    Attributes:
        navigator: The navigator.
        decision: Last decision of the navigator.
    """

    def __init__(self, navigator: Decider, lidar_x: float, reach: float = math.inf) -> None:
        self.navigator, self._lidar_x, self._reach = navigator, lidar_x, reach
        self.decision = Decision(_STAND, NavigatorState.WAITING, "waiting for a map")
        self._watch = Watch(lidar_x)
        self._echoes, self._seen_from = np.empty((0, 2)), _NOWHERE

    def see(self, sensors: Sensors) -> None:
        """Process a scan, with the odometry and (if known) the pose at its time."""
        try:
            points = view_scan(sensors.ranges, sensors.scan, math.inf, self._lidar_x).points
        except ScanError:
            return
        points = points[~self._watch.see(sensors)]
        self._echoes = points[np.hypot(*points.T) < self._reach]
        self._seen_from = _place(sensors)
        if sensors.pose is not None:
            empty = _empty_beams(sensors.ranges, sensors.scan, self._lidar_x)
            self.navigator.see(sensors.time, sensors.pose, points, empty)

    def command(self, sensors: Sensors) -> Array:
        """Return the command (2,); zeros if the pose is unknown. A new scan is processed first."""
        self.navigator.sent(sensors.command)
        if sensors.age == 0.0:
            self.see(sensors)
        if sensors.pose is None:
            return self.wait(sensors.time, "the pose is unknown")
        x, y, yaw = (_place(sensors).inverse() @ self._seen_from).pose.tolist()
        c, s = math.cos(yaw), math.sin(yaw)
        echoes = self._echoes @ np.array(((c, s), (-s, c))) + (x, y)
        self.decision = self.navigator.decide(sensors.time, sensors.pose, echoes, self._watch.movers(sensors))
        return self.decision.command

    def wait(self, now: float, problem: str, remaining_time: float = math.nan) -> Array:
        """Keep background work going and return the stop command (2,), with `problem` as the reason."""
        self.navigator.poll(now)
        self.decision = Decision(_STAND, NavigatorState.WAITING, problem, remaining_time)
        return _STAND


def _place(sensors: Sensors) -> Transform:
    """Return the odometry pose."""
    return Transform.planar(*planar(sensors.odometry[:7].tolist()).tolist())


def _empty_beams(ranges: NDArray[np.float32], scan: ScanGeometry, forward: float) -> Array:
    """Return where beams without an echo end in the robot's frame (n, 2) [m]; the lidar is `forward` [m] ahead."""
    empty = np.flatnonzero(np.isposinf(measured(ranges, scan)))
    bearings, far = scan.angle_min + scan.angle_increment * empty, min(scan.range_max, _FARTHEST)
    return np.column_stack((forward + far * np.cos(bearings), far * np.sin(bearings)))

"""Drives a robot to a goal without a map: the time to reach is solved repeatedly on the space seen so far."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_navigation.driving.look_ahead import REVERSING, TURNS_AFTER, LookAhead
from ctrl_rl_navigation.driving.scan_map import ScanMap
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.people import Tracker
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import MapSolver
from ctrl_rl_navigation.values.map_value import MapValue

Array = NDArray[np.float64]

_BESIDE = 1.0
"""Distance within which mapped obstacles outside the scan, behind the robot, are considered [m]."""
_THIN = 0.03
"""Side length of the cells that thin the echoes of the look-ahead to one per cell [m]."""
_STAYS = 0.1
"""Radius within which a robot counts as staying in place [m]."""
_TURNS = 0.5
"""Rotation that counts as progress in place [rad]."""
_PATIENCE = 1.0
"""Time without progress after which a robot is stuck [s]."""
_LEFT = 0.5
"""Distance from the place at which the robot is no longer stuck [m]."""


@dataclass(frozen=True)
class ExplorerOptions:
    """Settings of an explorer.

    Attributes:
        tolerance: Distance at which the goal counts as reached [m].
        resolution: Side length of the map cells [m].
        margin: Margin of the map around start and goal [m].
        solve_period: Interval between solves of the value function [s].
        period: Control period [s].
        delay: Time from a command to its effect, plus the time until the next one [s].
        deceleration: Braking deceleration of the robot [m/s^2].
        step: Time step of the look-ahead [s].
        horizon: Horizon of the look-ahead [s].
        ease: Additional clearance for full speed [m].
        slowest: Fraction of the full speed next to an obstacle.
    """

    tolerance: float = 0.5
    resolution: float = 0.05
    margin: float = 3.0
    solve_period: float = 0.25
    period: float = 0.05
    delay: float = 0.1
    deceleration: float = 4.0
    step: float = 0.05
    horizon: float = 1.2
    ease: float = 0.3
    slowest: float = 0.3


class Explorer:
    """Drives one robot to one goal.

    Attributes:
        limits: Size and limits of the robot.
        options: Settings of the explorer.
        goal: Position of the goal in the odometry frame [m].
        value: Time to reach the goal; None before the first scan.
    """

    def __init__(
        self, limits: DriveLimits, start: Array, goal: tuple[float, float], options: ExplorerOptions | None = None
    ) -> None:
        self.limits, self.goal = limits, goal
        self.options = settings = options or ExplorerOptions()
        self._map = ScanMap(np.array((start[:2], goal)), settings.margin, settings.resolution)
        self._ahead = LookAhead(
            limits,
            settings.period,
            settings.delay,
            settings.deceleration,
            settings.step,
            settings.horizon,
            settings.ease,
            settings.slowest,
            TURNS_AFTER,
            REVERSING,
        )
        self.value: MapValue | None = None
        self._tracker = Tracker()
        self._echoes: Array = np.empty((0, 2))
        self._command, self._plan = np.zeros(2), np.zeros(4)
        self._watch = StuckWatch()
        self._seen, self._solved_at = False, -math.inf

    def sent(self, command: Array) -> None:
        """Record the command actually sent; acceleration limits apply relative to this command."""
        self._command = np.array(command, np.float64)

    def see(self, now: float, origin: Array, ends: Array, echoes: NDArray[np.bool_], heading: float = 0.0) -> None:
        """Add a scan to the map, except for moving obstacles.

        Args:
            now: Steady time [s].
            origin: Position of the lidar (2,) [m].
            ends: End points of the beams, in beam order (n, 2) [m].
            echoes: Whether each beam hit something (n,).
            heading: Heading of the robot by its odometry [rad].
        """
        self._seen, stands = True, echoes.copy()
        stands[echoes] = ~self._tracker.update(now, origin, ends, echoes, heading)
        self._echoes = ends[stands]
        self._map.see(origin, ends, stands)

    def decide(self, now: float, pose: Array) -> Array:
        """Return the speed and turn rate to send (2,) [m/s, rad/s]; zero before the first scan and at the goal.

        Args:
            now: Steady time [s].
            pose: Odometry pose at the time of the last scan (3,) [m, m, rad].
        """
        if not self._seen or math.dist(pose[:2], self.goal) <= self.options.tolerance:
            return np.zeros(2)
        if now - self._solved_at >= self.options.solve_period:
            self._solved_at = now
            self._solve()
        if self.value is None:
            return np.zeros(2)
        movers = self._tracker.movers()
        stuck = self._watch.stuck(now, pose) and not len(movers)  # waiting is useful if something is moving
        choice = self._ahead.choose(self.value, pose, self._command, self._around(pose), self._plan, stuck, movers)
        self._plan = choice.plan
        return choice.command

    def _solve(self) -> None:
        """Solve the time to reach on the current map; keep the old value if walls cover the goal."""
        solver = MapSolver(self._map.occupancy(), self.limits, self.options.slowest, self.options.ease, True)
        try:
            self.value = solver.solve(self.goal, self.options.tolerance, widest=2.0 * self.options.tolerance)
        except NavigationError:
            return

    def _around(self, pose: Array) -> Array:
        """Return echoes near the robot in its frame (n, 2) [m], with mapped obstacles outside the scan."""
        near = self._echoes[np.hypot(*(self._echoes - pose[:2]).T) < self._ahead.reach]
        cells = np.floor(near / _THIN).astype(np.int64)
        _, first = np.unique(cells[:, 0] * 1_000_003 + cells[:, 1], return_index=True)
        known = np.concatenate((near[first], self._map.points_near(pose[:2], _BESIDE)))
        c, s = math.cos(pose[2]), math.sin(pose[2])
        points = (known - pose[:2]) @ np.array(((c, -s), (s, c)))
        seen = np.arange(len(points)) < len(first)
        return np.asarray(points[seen | (points[:, 0] < 0.0)], float)


class StuckWatch:
    """Tracks poses; a robot that stays in one place is stuck until it leaves."""

    def __init__(self) -> None:
        self._pose: Array = np.full(3, math.inf)
        self._since, self._stuck = math.inf, False

    def stuck(self, now: float, pose: Array) -> bool:
        """Return whether the robot is stuck.

        Args:
            now: Steady time [s].
            pose: Pose x, y, theta of the robot (3,) [m, m, rad].
        """
        moved = math.dist(pose[:2], self._pose[:2])
        if self._stuck:
            self._stuck = moved < _LEFT
        elif moved > _STAYS or abs(math.remainder(pose[2] - self._pose[2], 2.0 * math.pi)) > _TURNS:
            self._pose, self._since = pose.copy(), now
        else:
            self._stuck = now - self._since >= _PATIENCE
        return self._stuck

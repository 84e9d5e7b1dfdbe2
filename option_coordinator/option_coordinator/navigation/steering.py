"""Steering of one robot: the reactive planner, and a way out where two robots block each other."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from option_coordinator.navigation.planner import STAND, Array, ReactivePlanner, seen_from

_STUCK_WITHIN = 0.3
"""A robot that stays within this distance is stuck [m]."""
_PATIENCE, _PATIENCE_SPREAD = 8.0, 12.0
"""Time until the first robot of a team is stuck, and until the last one is, in addition [s]."""
_GOLDEN = 0.618034
_TRAIL_STEP, _TRAIL_POINTS = 0.1, 300
_BESIDE = 0.3
_ELBOW_ROOM = 1.0
"""Width between the nearest points left and right that lets two robots pass [m]."""
_FURTHER = 0.4
"""Distance to back out beyond the first place with elbow room, for each attempt [m]."""
_HOLD = 6.0
"""Time for which the other robot may pass, for each attempt [s]."""
_PAUSE = 1.0
"""Time without driving after which the robot starts anew [s]."""


class _TrailPoint(NamedTuple):
    """A place where the robot has been, with the width that was free there, across its heading [m]."""

    place: tuple[float, float]
    width: float


class Steering:
    """Drives one robot to its goal; a robot that is stuck backs out along its own trail, waits, and tries again.

    Two robots that meet in a narrow aisle block each other: neither has room to pass. The robots of a team differ in
    patience, so that one backs out while the other one still waits, and then goes on. Each further attempt leads
    further back and waits longer.

    Args:
        planner: Planner of the velocities.
        rank: Number of the robot in its team, which determines its patience.

    Attributes:
        attempts: How often the robot has backed out on the way to its present goal.
    """

    def __init__(self, planner: ReactivePlanner, rank: int = 0) -> None:
        self.planner = planner
        self._patience = _PATIENCE + _PATIENCE_SPREAD * (rank * _GOLDEN % 1.0)
        self._trail: deque[_TrailPoint] = deque(maxlen=_TRAIL_POINTS)
        self._goal: tuple[float, float] | None = None
        self._retreat: tuple[float, float] | None = None
        self.attempts, self._hold_until = 0, -math.inf
        self._mark, self._marked_at, self._called_at = (math.inf, math.inf), 0.0, -math.inf

    def there(self, pose: Array, goal: tuple[float, float]) -> bool:
        """Return whether a pose x, y, theta (3,) is at the goal."""
        return self.planner.there(pose, goal)

    def command(self, pose: Array, points: Array, goal: tuple[float, float], now: float) -> tuple[float, float]:
        """Return speed [m/s] and turn rate [rad/s].

        Args:
            pose: Pose x, y [m], theta [rad] (3,).
            points: Points seen by the lidar, in the frame of the pose (n, 2) [m].
            goal: Goal position [m].
            now: Time [s].
        """
        here = (float(pose[0]), float(pose[1]))
        if goal != self._goal or now - self._called_at > _PAUSE:
            self._goal, self._retreat, self.attempts, self._hold_until = goal, None, 0, -math.inf
            self._marked_at = now
        self._called_at = now
        if math.dist(here, self._mark) > _STUCK_WITHIN:
            self._mark, self._marked_at = here, now
        if now < self._hold_until:
            self._marked_at = now
            return STAND
        stuck = now - self._marked_at > self._patience
        if self._retreat is not None:
            if not stuck and not self.planner.there(pose, self._retreat):
                return self.planner.command(pose, points, self._retreat)
            self._retreat, self._hold_until, self._marked_at = None, now + _HOLD * self.attempts, now
            return STAND
        self._remember(pose, points)
        if stuck and self._trail:
            self.attempts += 1
            self._retreat, self._marked_at = self._place_to_wait(here), now
        return self.planner.command(pose, points, self._retreat or goal)

    def _remember(self, pose: Array, points: Array) -> None:
        here = (float(pose[0]), float(pose[1]))
        if not self._trail or math.dist(here, self._trail[-1].place) >= _TRAIL_STEP:
            self._trail.append(_TrailPoint(here, _free_width(pose, points)))

    def _place_to_wait(self, here: tuple[float, float]) -> tuple[float, float]:
        """Return the nearest place back on the trail that is wide enough for two robots, and somewhat further."""
        left, way, last = _FURTHER * self.attempts, 0.0, here
        for place, width in reversed(self._trail):
            step, last = math.dist(last, place), place
            way += step
            if way >= _FURTHER and width >= _ELBOW_ROOM:
                left -= step
                if left <= 0.0:
                    break
        return last


def _free_width(pose: Array, points: Array) -> float:
    """Return the width between the nearest points left and right of a robot [m]."""
    points = seen_from(pose, points)
    aside = points[np.abs(points[:, 0]) < _BESIDE, 1]
    left, right = aside[aside > 0.0], -aside[aside < 0.0]
    return float(left.min() + right.min()) if len(left) and len(right) else math.inf

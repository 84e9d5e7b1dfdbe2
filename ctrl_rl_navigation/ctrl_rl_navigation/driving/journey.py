"""A journey: goals that a navigator drives to one after the other, with progress and failure. No ROS."""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_navigation.driving.decision import Decision, Goal, NavigatorState
from ctrl_rl_navigation.driving.path_legs import Leg
from ctrl_rl_navigation.values.map_value import path_length

Array = NDArray[np.float64]

PASS_RADIUS = 0.5
"""Distance at which a robot that need not stop there has passed a goal [m]."""
_SLOW = 3.0
"""Factor over the time at full speed within which a passed goal must be reachable: else it is behind a wall."""
_LONGEST_STEP = 1.0
"""Time between two decisions of which more does not count [s]: a simulated clock leaps when it starts."""
_STUCK = (NavigatorState.BLOCKED, NavigatorState.WAITING)


class Failure(Enum):
    """Reason why a journey failed."""

    NO_WAY = auto()
    """No way leads to a goal."""
    BLOCKED = auto()
    """Obstacles have stopped the robot for too long."""
    NO_INPUT = auto()
    """The map, the pose or a sensor has been missing for too long."""
    REPLACED = auto()
    """Another goal or a cancel took over the navigator."""


class Travelled(Protocol):
    """What a journey needs of a navigator."""

    @property
    def goal(self) -> Goal | None:
        """Current or last reached goal."""

    @property
    def is_asked(self) -> bool:
        """Whether a goal is still without a value."""

    @property
    def remaining_distance(self) -> float:
        """Remaining path length [m]; NaN without a path."""

    def set_goal(self, goal: Goal) -> None:
        """Drive to another goal."""

    def cancel(self) -> bool:
        """Cancel the goal."""


class Journey:
    """Drives a navigator to goals in order; call `update` after each decision.

    Args:
        navigator: The navigator.
        legs: Goals, at least one.
        speed: Full speed of the robot [m/s].
        patience: Time for which the robot may be blocked or without an input before the journey fails [s].
        stops: Whether the robot stops at each goal, instead of passing all but the last.

    Attributes:
        index: Number of the current goal.
        recoveries: How often the robot was blocked and went on.
        failure: Reason of the failure; None while there is none.
        reason: The same in words.
        arrived: Whether the last goal is reached.
    """

    def __init__(self, navigator: Travelled, legs: list[Leg], speed: float, patience: float, stops: bool) -> None:
        self._navigator, self._legs, self._speed, self._patience, self._stops = navigator, legs, speed, patience, stops
        self.index = self.recoveries = 0
        self.failure: Failure | None = None
        self.reason = ""
        self.arrived = False
        self._stuck_for, self._watched_at = 0.0, math.inf
        self._state = NavigatorState.WAITING
        navigator.set_goal(self._goal)

    @property
    def left(self) -> int:
        """Number of goals that are not reached."""
        return len(self._legs) - self.index

    @property
    def _goal(self) -> Goal:
        return self._legs[self.index].goal

    def update(self, now: float, decision: Decision, pose: Array | None) -> None:
        """Note a decision at a steady time [s] and a pose (3,), and set the next goal where one is reached."""
        if self.failure is not None or self.arrived:
            return
        self._watch(now, decision)
        if self.failure is not None or self._navigator.is_asked:
            return
        if self._navigator.goal is not self._goal:
            refused = decision.state is NavigatorState.UNREACHABLE
            self._fail(Failure.NO_WAY if refused else Failure.REPLACED, decision.message)
        elif decision.state is NavigatorState.UNREACHABLE:
            self._fail(Failure.NO_WAY, decision.message)
        elif decision.state is NavigatorState.REACHED or self._passes(decision, pose):
            self._advance()

    def remaining(self, decision: Decision, pose: Array) -> tuple[float, float]:
        """Return distance [m] and time [s] to the last goal; beyond the current goal they are those of the legs."""
        rest = sum(leg.length for leg in self._legs[self.index + 1 :])
        here = self._ahead(pose)
        seconds = decision.remaining_time if math.isfinite(decision.remaining_time) else here / self._speed
        return here + rest, seconds + rest / self._speed

    def _ahead(self, pose: Array) -> float:
        """Return the distance to the current goal [m]: along its path, along the navigator's, or straight."""
        if self._goal.path is not None:
            path = np.array(self._goal.path)
            return path_length(path[int(np.argmin(np.hypot(*(path - pose[:2]).T))) :])
        distance = math.nan if self._navigator.is_asked else self._navigator.remaining_distance
        return distance if math.isfinite(distance) else math.dist(pose[:2], self._goal.position)

    def _watch(self, now: float, decision: Decision) -> None:
        """Count how often and for how long the robot is stuck."""
        before, self._state = self._state, decision.state
        step, self._watched_at = min(max(now - self._watched_at, 0.0), _LONGEST_STEP), now
        if decision.state not in _STUCK:
            self.recoveries += before is NavigatorState.BLOCKED
            self._stuck_for = 0.0
            return
        self._stuck_for += step
        if self._stuck_for > self._patience:
            failure = Failure.BLOCKED if decision.state is NavigatorState.BLOCKED else Failure.NO_INPUT
            self._fail(failure, f"{decision.message} (for {self._patience:g} s)")

    def _passes(self, decision: Decision, pose: Array | None) -> bool:
        if self._stops or self.left == 1 or pose is None:
            return False
        near = math.dist(pose[:2], self._goal.position) <= PASS_RADIUS
        return near and decision.remaining_time <= _SLOW * PASS_RADIUS / self._speed

    def _advance(self) -> None:
        self.arrived = self.left == 1
        self.index += 1
        if not self.arrived:
            self._navigator.set_goal(self._goal)

    def _fail(self, failure: Failure, reason: str) -> None:
        """End the journey; the robot stands, unless another goal has taken over."""
        self.failure, self.reason = failure, reason
        if failure is not Failure.REPLACED:
            self._navigator.cancel()

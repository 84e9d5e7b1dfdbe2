"""Holds the value of a car's current goal, and solves those of other goals, maps and obstacles in the background."""

from __future__ import annotations

import math
from enum import Enum, auto

import numpy as np
from ctrl_rl_core.processes import Job, start_job
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.cars.car_limits import CarLimits
from ctrl_rl_navigation.cars.car_solver import CarSolver
from ctrl_rl_navigation.cars.car_value import CarValue
from ctrl_rl_navigation.driving.decision import Goal, NavigatorOptions
from ctrl_rl_navigation.errors import NavigationError

Array = NDArray[np.float64]
_NONE: Array = np.empty((0, 2))
_INSIDE = 0.6
"""Fraction of the tolerances at which the value is zero, so that the car stops well within them."""


class News(Enum):
    """Result of background work."""

    NOTHING = auto()
    MAP = auto()
    """Another map is in use."""
    GOAL = auto()
    """The value of another goal is in use."""
    REFUSED = auto()
    """Another goal has no value; there is no goal any more."""
    RENEWED = auto()
    """The value of the current goal was solved again."""
    TAKEN = auto()
    """Obstacles cover the current goal; the previous value is kept."""


class CarKeeper:
    """Manages the value of the current goal; the old goal stays until the value of the next one is solved.

    Attributes:
        solver: Solver for the current map; None before the first map.
        goal: Goal of the current value; None for none.
        value: Current value; None for none.
        known: Unmapped obstacles included in the value (n, 2) [m].
        reason: Reason for the last refusal.
        solves: Number of values solved.
        pose: Pose of the car (3,) [m, m, rad], a while beyond which a solve ends; None to solve all of the map.
    """

    def __init__(self, limits: CarLimits, options: NavigatorOptions) -> None:
        self._limits, self._options = limits, options
        self.solver: CarSolver | None = None
        self.goal: Goal | None = None
        self.value: CarValue | None = None
        self.known: Array = _NONE
        self.reason = ""
        self.solves = 0
        self._next_goal: Goal | None = None
        self._obstacles: Array = _NONE
        self._new_map: Job[CarSolver] | None = None
        self._job: Job[CarValue] | None = None
        self.pose: Array | None = None

    @property
    def at_work(self) -> bool:
        """Whether a solve is running."""
        return self._job is not None

    @property
    def done(self) -> float:
        """Completed fraction of the running solve; NaN if there is none."""
        return math.nan if self._job is None else self._job.done

    @property
    def prepares_map(self) -> bool:
        """Whether a map is being prepared."""
        return self._new_map is not None

    @property
    def is_asked(self) -> bool:
        """Whether a goal is still without a value."""
        return self._next_goal is not None

    def set_map(self, map_: OccupancyMap) -> None:
        """Start preparing another map."""
        self._new_map = start_job(lambda _: CarSolver(map_, self._limits), self._options.inline)

    def ask(self, goal: Goal) -> None:
        """Start solving for another goal; an older request is dropped."""
        self._next_goal = goal
        self._solve(_NONE)

    def renew(self, obstacles: Array) -> None:
        """Start solving for the current goal with obstacles (n, 2) [m]."""
        self._solve(obstacles)

    def drop(self) -> None:
        """Drop goals, value and background work."""
        self._stop_work()
        self.goal = self._next_goal = self.value = None
        self.known = _NONE

    def poll(self, keep_goal: bool) -> News:
        """Process finished background work, and return what changed.

        Args:
            keep_goal: Whether to solve the current goal on a new map too.
        """
        if self._new_map is not None and self._new_map.finished.is_set():
            self._take_map(self._new_map, keep_goal)
            return News.MAP
        if self._job is not None and self._job.finished.is_set():
            return self._take_value(self._job)
        return News.NOTHING

    def _take_map(self, job: Job[CarSolver], keep_goal: bool) -> None:
        self._new_map = None
        if job.result is None:
            raise job.error or NavigationError("the map was not prepared")
        self.solver = job.result
        if keep_goal:
            self._next_goal = self._next_goal or self.goal
        if self._next_goal is not None:
            self._solve(_NONE)

    def _take_value(self, job: Job[CarValue]) -> News:
        self._job = None
        if job.error is not None and not isinstance(job.error, NavigationError):
            raise job.error
        is_new = self._next_goal is not None
        if job.result is None:
            self.reason = str(job.error)
            if is_new:
                self.drop()
                return News.REFUSED
            self.known = self._obstacles
            return News.TAKEN
        if is_new:
            self.goal, self._next_goal = self._next_goal, None
        self.value, self.known = job.result, self._obstacles
        self.solves += 1
        return News.GOAL if is_new else News.RENEWED

    def _solve(self, obstacles: Array) -> None:
        """Start solving for the next goal, or again for the current one."""
        self._stop_work()
        goal, solver, options = self._next_goal or self.goal, self.solver, self._options
        if goal is None or solver is None:
            return
        self._obstacles, pose = obstacles, self.pose

        def work(job: Job[CarValue]) -> CarValue:
            def report(share: float) -> None:
                job.done = share

            return solver.solve(
                goal.position,
                goal.heading,
                _INSIDE * options.tolerance,
                _INSIDE * options.heading_tolerance,
                obstacles,
                report,
                lambda: job.wanted,
                pose,
            )

        self._job = start_job(work, options.inline)

    def _stop_work(self) -> None:
        if self._job is not None:
            self._job.cancel()
            self._job = None

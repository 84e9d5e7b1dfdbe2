"""Holds the value of the current goal, and solves values of other goals, maps and obstacles in the background."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum, auto
from typing import Generic, TypeVar

import numpy as np
from ctrl_rl_core.processes import Job, start_job
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.driving.decision import Goal
from ctrl_rl_navigation.errors import NavigationError

Array = NDArray[np.float64]
Solver = TypeVar("Solver")
Value = TypeVar("Value")
Work = Callable[[Callable[[float], None], Callable[[], bool]], Value]
"""Solves a value; reports the completed fraction, and asks whether the value is still wanted."""
_NONE: Array = np.empty((0, 2))


class Change(Enum):
    """Result of background work."""

    NOTHING = auto()
    MAP = auto()
    """Another map is in use."""
    GOAL = auto()
    """The value of another goal is in use."""
    REFUSED = auto()
    """Another goal has no value; there is no goal any more."""
    RENEWED = auto()
    """The value of the current goal was recomputed."""
    TAKEN = auto()
    """Obstacles cover the current goal; the previous value is kept."""


class ValueKeeper(Generic[Solver, Value]):
    """Manages the value of the current goal; the old goal stays until the value of the next one is solved.

    Args:
        prepare: Returns the solver for a map; runs in the background.
        plan: Returns what solves the value of a goal with unmapped obstacles (n, 2) [m]. The result runs in the
            background.
        inline: Whether to solve values synchronously instead of in a thread.

    Attributes:
        solver: Solver for the current map; None before the first map.
        goal: Goal of the current value; None for none.
        value: Current value; None for none.
        known: Unmapped obstacles included in the value (n, 2) [m].
        reason: Reason for the last refusal.
        solves: Number of values solved.
    """

    def __init__(
        self,
        prepare: Callable[[OccupancyMap], Solver],
        plan: Callable[[Solver, Goal, Array], Work[Value]],
        inline: bool,
    ) -> None:
        self._prepare, self._plan, self._inline = prepare, plan, inline
        self.solver: Solver | None = None
        self.goal: Goal | None = None
        self.value: Value | None = None
        self.known: Array = _NONE
        self.reason = ""
        self.solves = 0
        self._next_goal: Goal | None = None
        self._obstacles: Array = _NONE
        self._new_map: Job[Solver] | None = None
        self._job: Job[Value] | None = None

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
        self._new_map = start_job(lambda _: self._prepare(map_), self._inline)

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

    def poll(self, keep_goal: bool) -> Change:
        """Process finished background work, and return the changes.

        Args:
            keep_goal: Whether to solve the current goal on a new map too.
        """
        if self._new_map is not None and self._new_map.finished.is_set():
            self._take_map(self._new_map, keep_goal)
            return Change.MAP
        if self._job is not None and self._job.finished.is_set():
            return self._take_value(self._job)
        return Change.NOTHING

    def _take_map(self, job: Job[Solver], keep_goal: bool) -> None:
        self._new_map = None
        if job.result is None:
            raise job.error or NavigationError("the map was not prepared")
        self.solver = job.result
        if keep_goal:
            self._next_goal = self._next_goal or self.goal
        if self._next_goal is not None:
            self._solve(_NONE)

    def _take_value(self, job: Job[Value]) -> Change:
        self._job = None
        if job.error is not None and not isinstance(job.error, NavigationError):
            raise job.error
        is_new = self._next_goal is not None
        if job.result is None:
            self.reason = str(job.error)
            if is_new:
                self.drop()
                return Change.REFUSED
            self.known = self._obstacles
            return Change.TAKEN
        if is_new:
            self.goal, self._next_goal = self._next_goal, None
        self.value, self.known = job.result, self._obstacles
        self.solves += 1
        return Change.GOAL if is_new else Change.RENEWED

    def _solve(self, obstacles: Array) -> None:
        """Start solving for the next goal, or again for the current one."""
        self._stop_work()
        goal, solver = self._next_goal or self.goal, self.solver
        if goal is None or solver is None:
            return
        self._obstacles = obstacles
        solve = self._plan(solver, goal, obstacles)

        def work(job: Job[Value]) -> Value:
            def report(share: float) -> None:
                job.done = share

            return solve(report, lambda: job.wanted)

        self._job = start_job(work, self._inline)

    def _stop_work(self) -> None:
        if self._job is not None:
            self._job.cancel()
            self._job = None

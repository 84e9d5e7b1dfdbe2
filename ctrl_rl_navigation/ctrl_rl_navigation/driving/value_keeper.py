"""Keeps the value of the present goal, and solves those of other goals, maps and obstacles in the background."""

from __future__ import annotations

import math
from enum import Enum, auto

import numpy as np
from ctrl_rl_core.processes import Job, start_job
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.driving.decision import Goal
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import MapSolver
from ctrl_rl_navigation.values.map_value import MapValue

Array = NDArray[np.float64]
_NONE: Array = np.empty((0, 2))


class Change(Enum):
    """News of the background."""

    NOTHING = auto()
    MAP = auto()
    """Another map is in use."""
    GOAL = auto()
    """The value of another goal is in use."""
    REFUSED = auto()
    """Another goal has no value; there is no goal any more."""
    RENEWED = auto()
    """The value of the present goal was solved anew."""
    TAKEN = auto()
    """Obstacles leave no place at the present goal; its value is the one from before."""


class ValueKeeper:
    """The value of the present goal.

    Args:
        limits: Size and speed of the robot.
        radius: Distance from a goal at which its value is zero [m].
        widest: The same for goals that the robot cannot come so near to [m].
        inline: Whether values are solved at once instead of in a thread.

    Attributes:
        solver: Solver on the map in use; None before the first map.
        goal: Goal whose value is in use; None for none.
        value: Value in use; None for none.
        known: Obstacles that it was solved with, besides the map's (n, 2) [m].
        reason: Reason of the last refusal.
        solves: Number of values that were solved.
    """

    def __init__(self, limits: DriveLimits, radius: float, widest: float, inline: bool) -> None:
        self._limits, self._radius, self._widest, self._inline = limits, radius, widest, inline
        self.solver: MapSolver | None = None
        self.goal: Goal | None = None
        self.value: MapValue | None = None
        self.known: Array = _NONE
        self.reason = ""
        self.solves = 0
        self._next_goal: Goal | None = None
        self._obstacles: Array = _NONE
        self._new_map: Job[MapSolver] | None = None
        self._job: Job[MapValue] | None = None

    @property
    def at_work(self) -> bool:
        """Whether a value is in work."""
        return self._job is not None

    @property
    def done(self) -> float:
        """Share of the value in work that is done; NaN while none is."""
        return math.nan if self._job is None else self._job.done

    @property
    def prepares_map(self) -> bool:
        """Whether a map is in work."""
        return self._new_map is not None

    @property
    def is_asked(self) -> bool:
        """Whether there is a goal that has no value yet."""
        return self._next_goal is not None

    def set_map(self, map_: OccupancyMap) -> None:
        """Prepare another map."""
        self._new_map = start_job(lambda _: MapSolver(map_, self._limits), self._inline)

    def ask(self, goal: Goal) -> None:
        """Solve for another goal; an older request is dropped."""
        self._next_goal = goal
        self._solve(_NONE)

    def renew(self, obstacles: Array) -> None:
        """Solve for the present goal with obstacles (n, 2) [m]."""
        self._solve(obstacles)

    def drop(self) -> None:
        """Drop goals, value and work."""
        self._stop_work()
        self.goal = self._next_goal = self.value = None
        self.known = _NONE

    def poll(self, keep_goal: bool) -> Change:
        """Take what the background has finished, and return the news.

        Args:
            keep_goal: Whether the present goal is solved on another map, too.
        """
        if self._new_map is not None and self._new_map.finished.is_set():
            self._take_map(self._new_map, keep_goal)
            return Change.MAP
        if self._job is not None and self._job.finished.is_set():
            return self._take_value(self._job)
        return Change.NOTHING

    def _take_map(self, job: Job[MapSolver], keep_goal: bool) -> None:
        self._new_map = None
        if job.result is None:
            raise job.error or NavigationError("the map was not prepared")
        self.solver = job.result
        if keep_goal:
            self._next_goal = self._next_goal or self.goal
        if self._next_goal is not None:
            self._solve(_NONE)

    def _take_value(self, job: Job[MapValue]) -> Change:
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
        """Begin to solve for the next goal, or anew for the present one."""
        self._stop_work()
        goal, solver = self._next_goal or self.goal, self.solver
        if goal is None or solver is None:
            return
        self._obstacles = obstacles

        def work(job: Job[MapValue]) -> MapValue:
            def report(share: float) -> None:
                job.done = share

            wanted = lambda: job.wanted  # noqa: E731
            return solver.solve(goal.position, self._radius, obstacles, report, wanted, self._widest)

        self._job = start_job(work, self._inline)

    def _stop_work(self) -> None:
        if self._job is not None:
            self._job.cancel()
            self._job = None

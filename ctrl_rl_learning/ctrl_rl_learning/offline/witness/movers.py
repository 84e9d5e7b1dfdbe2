"""Where a task's movers may be: what ends there is no wall."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ctrl_rl_core import MoverPlan, NavigationTask, World, draw_movers

Array = NDArray[np.float64]
_DRAWS, _EVERY, _BESIDE = 30, 0.2, 0.15
"""Draws of the movers that show where they may be, times between their places [s], and distance that is near [m]."""
_GAP, _TRIES = 0.1, 100
"""Least gap between a robot and a mover at the start [m], and number of draws that look for it."""


class MoverReach:
    """Places where the movers of a task may be, by draws of its own law.

    Args:
        task: Task with movers or without.
        worlds: Worlds of its episodes.
        random: Draws worlds and movers.
        wanderers: Whether those count that walk anywhere; only those that follow a track may stand somewhere for long.

    Raises:
        TaskError: No path of a mover is clear of walls and obstacles.
    """

    def __init__(
        self, task: NavigationTask, worlds: Sequence[World], random: np.random.Generator, *, wanderers: bool = True
    ) -> None:
        counted = [wanderers or spec.wander is None for spec in task.movers]
        places, radii = [], []
        for _ in range(_DRAWS if any(counted) else 0):
            plans = draw_movers(task, worlds[int(random.integers(len(worlds)))], random)
            for plan in (plan for plan, counts in zip(plans, counted, strict=True) if counts):
                times = np.arange(0.0, plan.motion.duration + _EVERY, _EVERY)
                places += [plan.motion.position(time) for time in times.tolist()]
                radii.append(plan.radius)
        self._tree = cKDTree(np.array(places)) if places else None
        self._radius = max(radii, default=0.0)

    def holds(self, points: Array, beside: float = 0.0) -> NDArray[np.bool_]:
        """Return whether points (n, 2) lie where a mover may be, or up to `beside` [m] from there (n,)."""
        if self._tree is None or not len(points):
            return np.zeros(len(points), dtype=np.bool_)
        return np.asarray(self._tree.query(points)[0] < self._radius + _BESIDE + beside)


def draw_plans(
    task: NavigationTask, worlds: Sequence[World], starts: Array, random: np.random.Generator
) -> list[tuple[MoverPlan, ...]]:
    """Draw the movers of episodes that start at states (n, 3), by the task's own law: none begins at a robot.

    Args:
        task: Task with movers or without.
        worlds: Walls of each episode, or one world for all.
        starts: Where the robots start.
        random: Random generator.

    Raises:
        TaskError: No path of a mover is clear of walls and obstacles.
    """
    if not task.movers:
        return []
    every = [worlds[0]] * len(starts) if len(worlds) == 1 else worlds
    return [_clear_of(task, world, (x, y), random) for world, (x, y) in zip(every, starts[:, :2].tolist(), strict=True)]


def _clear_of(
    task: NavigationTask, world: World, start: tuple[float, float], random: np.random.Generator
) -> tuple[MoverPlan, ...]:
    for _ in range(_TRIES):
        plans = draw_movers(task, world, random)
        gap = min(math.dist(plan.motion.position(0.0), start) - plan.radius for plan in plans)
        if gap >= task.robot.radius + _GAP:
            break
    return plans

"""Start states of robots, drawn from a task's start set, clear of walls, obstacles and each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.geometry.shapes import Disc, World
from ctrl_rl_core.systems.system import System
from ctrl_rl_core.tasks.regions import position_indices, wrap
from ctrl_rl_core.tasks.task import NavigationTask, TaskError

Array = NDArray[np.float64]
_TRIES = 200
"""Number of draws of one robot's state before its layout is abandoned."""
_LAYOUTS = 50
"""Number of layouts to try before the start set counts as too small; the first robots of a layout may happen to leave
no room for another.
"""
_GAP = 0.1
"""Minimum gap between two robots, or a robot and a mover, at the start [m]."""


def draw_starts(
    task: NavigationTask,
    system: System,
    world: World,
    count: int,
    radius: float,
    random: np.random.Generator,
    movers: Sequence[Disc] = (),
) -> list[Array]:
    """Draw one start state (n,) for each of `count` robots, with components in the system's order.

    In a corridor, each further robot starts far enough along the path not to touch the previous one.

    Args:
        task: Task with the start set.
        system: System model of the task.
        world: Walls and obstacles.
        count: Number of robots.
        radius: Radius of a circle that encloses a robot [m].
        random: Random generator.
        movers: Discs of the moving obstacles at the start, which no robot may touch.

    Raises:
        TaskError: The start set has no room for this many robots.
    """
    most = 0
    for _ in range(_LAYOUTS):
        layout = _draw_layout(task, system, world, count, radius, random, movers)
        if len(layout) == count:
            return layout
        most = max(most, len(layout))
    if not most:
        raise TaskError(f"task '{task.name}' has no room for a robot at its start: move a wall, an obstacle or a mover")
    raise TaskError(f"task '{task.name}' has no room for {count} robots at its start: use {most} or fewer")


def _draw_layout(
    task: NavigationTask,
    system: System,
    world: World,
    count: int,
    radius: float,
    random: np.random.Generator,
    movers: Sequence[Disc],
) -> list[Array]:
    """Place robots one after the other, and return the start states of those that fit."""
    place = position_indices(system.state_names)
    distance = 2 * radius + _GAP
    layout: list[Array] = []
    for index in range(count):
        for _ in range(_TRIES):
            state = _in_corridor(task, system, world, index * distance, random)
            if state is None:
                state = task.start.region.sample(system.state_names, random)
            apart = all(np.linalg.norm(state[place] - other[place]) >= distance for other in layout)
            apart = apart and all(disc.signed_distance(state[place]) >= radius + _GAP for disc in movers)
            # The first robot may start anywhere in the start set: a long thin body may be closer to a wall than its
            # radius. It must not start in a partition.
            anywhere = index == 0 and task.doorways is None
            if apart and (anywhere or world.signed_distance(state[place]) >= radius):
                layout.append(state)
                break
        else:
            break
    return layout


def _in_corridor(
    task: NavigationTask, system: System, world: World, ahead: float, random: np.random.Generator
) -> Array | None:
    """Draw a start state in path coordinates, moved forward by `ahead` metres; None outside a corridor."""
    if world.path is None:
        return None
    intervals = task.start.intervals
    along, lateral, heading = task.start.region.sample(("s", "lateral", "heading"), random)
    spread = intervals["s"].length if "s" in intervals else 0.0
    x, y, direction = world.path.pose(along + (ahead + spread if ahead else 0.0))
    state = np.zeros(len(system.state_names))
    values = {
        "x": x - lateral * np.sin(direction),
        "y": y + lateral * np.cos(direction),
        "theta": float(wrap(direction + heading)),
    }
    for name, value in values.items():
        state[system.state_names.index(name)] = value
    return state

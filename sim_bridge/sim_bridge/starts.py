"""Where robots start: states drawn from the task's start set that keep clear of walls, obstacles and each other."""

from __future__ import annotations

import numpy as np
from ctrl_rl_core.geometry import World
from ctrl_rl_core.regions import position_indices, wrap
from ctrl_rl_core.systems import System
from ctrl_rl_core.tasks import NavigationTask
from numpy.typing import NDArray

from sim_bridge.errors import SimulationError

Array = NDArray[np.float64]
_TRIES = 200
_GAP = 0.1
"""Between two robots at the start [m]."""


def draw_starts(
    task: NavigationTask, system: System, world: World, count: int, radius: float, random: np.random.Generator
) -> list[Array]:
    """Return one start state (n,) for each of `count` robots, ordered as the system names it.

    In a corridor each further robot is set that much further along the path that two cannot touch.

    Args:
        task: holds the start set.
        system: of the task.
        world: walls and obstacles.
        count: of robots.
        radius: of a circle that holds a robot [m].
        random: draws the states.

    Raises:
        SimulationError: there is no room for so many.
    """
    place = position_indices(system.state_names)
    starts: list[Array] = []
    for index in range(count):
        for _ in range(_TRIES):
            state = _in_corridor(task, system, world, index * (2 * radius + _GAP), random)
            if state is None:
                state = task.start.region.sample(system.state_names, random)
            apart = all(np.linalg.norm(state[place] - other[place]) >= 2 * radius + _GAP for other in starts)
            # The first robot starts where the task says: a long thin body may be nearer to a wall than its radius.
            if apart and (index == 0 or world.signed_distance(state[place]) >= radius):
                break
        else:
            raise SimulationError(
                f"task '{task.name}' has no room for {count} robots at its start: use {index} or fewer"
            )
        starts.append(state)
    return starts


def _in_corridor(
    task: NavigationTask, system: System, world: World, ahead: float, random: np.random.Generator
) -> Array | None:
    """Return a start state drawn in path coordinates and set `ahead` metres on, None where there is no path."""
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

"""Draws an episode from its seed: walls, simulation settings, movers and start states."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import Disc, MoverPlan, NavigationTask, System, World, draw_movers, draw_starts
from sim_bridge.errors import SimulationError
from sim_bridge.simulation.options import SimulationOptions


class Purpose(IntEnum):
    """Purpose of a random stream."""

    START = 0
    WIDTH = 1
    SCAN = 2
    ODOMETRY = 3
    LOCALISATION = 4
    CONDITIONS = 5
    MOVERS = 6
    DOORWAYS = 7


def stream(seed: int, purpose: Purpose, robot: int = 0) -> np.random.Generator:
    """Return the random stream for one purpose of an episode's seed."""
    return np.random.default_rng((seed, robot, purpose))


Array = NDArray[np.float64]


class EpisodeDraws(NamedTuple):
    """Everything determined by the seed before an episode starts.

    Attributes:
        geometry: Walls and obstacles.
        conditions: Settings of the simulation, including those that the task randomises.
        movers: Plans of the moving obstacles.
        starts: State (n,) in which each robot starts.
    """

    geometry: World
    conditions: SimulationOptions
    movers: Sequence[MoverPlan]
    starts: Sequence[Array]


def draw_episode(
    task: NavigationTask,
    system: System,
    options: SimulationOptions,
    seed: int,
    robots: int = 1,
    width: float | None = None,
    start: Array | None = None,
) -> EpisodeDraws:
    """Draw an episode from its seed.

    Args:
        task: Task of the episode.
        system: Model of the task.
        options: Settings of the simulation.
        seed: Seed of the episode.
        robots: Number of robots.
        width: Free width of a corridor [m]; None for the task's, or a random one if the options say so.
        start: State (n,) in which the only robot starts; None to draw it.

    Raises:
        SimulationError, TaskError: The width is invalid for the task, or there is no room for the robots.
    """
    corridor = task.corridor
    if corridor is not None and width is None and options.randomise_width:
        width = float(stream(seed, Purpose.WIDTH).uniform(*corridor.width_range))
    geometry = task.build_world(width, stream(seed, Purpose.DOORWAYS))
    conditions = options.drawn(task.randomisation, stream(seed, Purpose.CONDITIONS))
    movers = draw_movers(task, geometry, stream(seed, Purpose.MOVERS))
    discs = [Disc(plan.motion.position(0.0), plan.radius) for plan in movers]
    starts = draw_starts(task, system, geometry, robots, task.robot.radius, stream(seed, Purpose.START), discs)
    return EpisodeDraws(geometry, conditions, movers, starts if start is None else [start])


def checked_start(start: ArrayLike, system: System, robots: int) -> Array:
    """Validate a given start and return it as a state (n,).

    Raises:
        SimulationError: The start is not a state of the system, or there are several robots.
    """
    state = np.array(start, dtype=float)
    if robots > 1 or state.shape != (len(system.state_names),) or not np.isfinite(state).all():
        names = ", ".join(system.state_names)
        raise SimulationError(f"a start must be a finite number for each of {names}, for a world of one robot")
    return state

"""Drives of a simulated burger with the navigator on a floor of which it has the map."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ctrl_rl_navigation.cli import DriveSimulation, Errors
from ctrl_rl_navigation.driving import Goal, NavigatorState
from numpy.typing import NDArray

from closed_doors.worlds import World

Array = NDArray[np.float64]

_PERIOD = 0.1
_STRETCH, _BESIDE, _ALIKE, _APART = 0.5, 0.35, math.cos(math.radians(45.0)), 4
"""Length of a stretch [m]; distance [m] and direction within which two are the same; stretches between two passes."""
_STANDS = 0.05
"""Radius within which a robot stands [m]."""


@dataclass(frozen=True)
class Outcome:
    """What became of a drive.

    Attributes:
        state: State of the navigator at the end.
        message: Its words.
        collided: Whether the robot touched something.
        seconds: Time until the goal was reached, or the robot stood for good [s].
        passes: How often any stretch was driven in one direction.
        solves: Number of values solved.
    """

    state: NavigatorState
    message: str
    collided: bool
    seconds: float
    passes: int
    solves: int


def drive(world: World, seed: int, longest: float) -> Outcome:
    """Drive to the goal, with the errors of a localiser and of odometry.

    Args:
        world: Floor, start and goal.
        seed: Seed of the errors.
        longest: Time after which the drive is ended [s].
    """
    with tempfile.TemporaryDirectory(prefix="closed_doors_") as folder:
        file = Path(folder) / "world.yaml"
        world.map_of(world.real).save(file)
        simulation = DriveSimulation(file, world.start, seed, Errors(), engine="planar")
        try:
            simulation.navigator.set_map(world.map_of(world.known))
            driven = simulation.drive(Goal(world.goal), longest)
            trace = np.array(simulation.robot.trace)
            message = simulation.decision.message
        finally:
            simulation.close()
    seconds = driven.seconds
    if driven.state is not NavigatorState.REACHED:
        away = np.hypot(*(trace[:, :2] - trace[-1, :2]).T)
        seconds = _PERIOD * float(np.flatnonzero(away > _STANDS)[-1] + 1)
    return Outcome(driven.state, message, driven.collided, seconds, most_passes(trace), driven.solves)


def most_passes(trace: Array) -> int:
    """Return how often a stretch of a path (n, 2 or more) [m] is driven in one direction, for the one driven most."""
    places = [trace[0, :2]]
    for place in trace[:, :2]:
        if math.dist(place, places[-1]) >= _STRETCH:
            places.append(place)
    ends = np.array(places[1:]).reshape(-1, 2)
    steps = np.diff(places, axis=0).reshape(-1, 2)
    steps = steps / np.hypot(*steps.T)[:, None]
    most = 1
    for i in range(len(ends)):
        same = (np.hypot(*(ends[: i + 1] - ends[i]).T) < _BESIDE) & (steps[: i + 1] @ steps[i] > _ALIKE)
        most = max(most, 1 + int((np.diff(np.flatnonzero(same)) > _APART).sum()))
    return most

"""Random clutter of a corridor: legs that leave a way on one side, and openings in the walls.

A policy that has only seen plain walls takes a leg for the end of the way and an opening for a turn of the corridor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.tasks import CorridorSpec, ObstacleSpec, OpeningSpec

from ctrl_rl_core import ArcPath, NavigationTask

KINDS = ("as the file says", "legs", "openings", "legs and openings")
"""Kinds of corridors, drawn equally often."""
_SPARE = 0.03, 0.15
"""Width of the way beside a leg beyond what the robot needs [m]."""
_LEG = 0.04, 0.15
"""Width of a leg [m]."""
_APART = 0.9, 1.8
"""Distance from leg to leg, and from opening to opening on one side [m]."""
_OPENING = 0.2, 1.0
"""Width of an opening [m]."""
_BEHIND = 0.1, 1.2
"""Distance from an opening to what stands behind it, in half of the cases [m]."""
_CLEAR = 0.35
"""Distance of legs from the start and from the end of the path [m]."""


class Corridor(NamedTuple):
    """The corridor of one episode.

    Attributes:
        task: Task with this corridor.
        width: Free width [m]; None to draw it as the task says.
        kind: One of `KINDS`.
    """

    task: NavigationTask
    width: float | None
    kind: str


def draw_corridor(task: NavigationTask, radius: float, seed: int) -> Corridor:
    """Draw the corridor of an episode.

    Args:
        task: Task with a corridor.
        radius: Radius with which the robot passes between posts [m].
        seed: Seed of the episode.
    """
    assert task.corridor is not None
    random = np.random.default_rng((seed, 44))
    kind = KINDS[int(random.integers(len(KINDS)))]
    if kind == KINDS[0]:
        return Corridor(task, None, kind)
    width = float(random.uniform(*task.corridor.width_range))
    corridor, obstacles = task.corridor, list(task.obstacles)
    if "legs" in kind:
        obstacles += _legs(task, width, radius, random)
    if "openings" in kind:
        corridor = corridor.model_copy(update={"openings": tuple(_openings(corridor.path.length, random))})
        obstacles += _behind(corridor, width, random)
    parts = {"corridor": corridor, "obstacles": tuple(obstacles), "doorways": None}
    return Corridor(task.model_copy(update=parts), width, kind)


def _legs(task: NavigationTask, width: float, radius: float, random: np.random.Generator) -> Iterator[ObstacleSpec]:
    """Yield legs of round section, each with a way of a little more than the robot's width beside it."""
    assert task.corridor is not None
    path, s = task.corridor.path, task.start.intervals["s"].high + _CLEAR + random.uniform(0.0, _APART[0])
    while s < path.length - _CLEAR:
        way = min(2.0 * radius + random.uniform(*_SPARE), width - _LEG[0])
        leg = min(random.uniform(*_LEG), width - way)
        yield _disc(path, s, random.choice((-1.0, 1.0)) * (0.5 * width - way - 0.5 * leg), 0.5 * leg)
        s += random.uniform(*_APART)


def _openings(length: float, random: np.random.Generator) -> Iterator[OpeningSpec]:
    for side in ("left", "right"):
        s = random.uniform(0.0, _APART[1])
        while s < length:
            wide = random.uniform(*_OPENING)
            yield OpeningSpec.model_validate({"s": f"{s:.4f} .. {s + wide:.4f} m", "side": side})
            s += wide + random.uniform(*_APART)


def _behind(corridor: CorridorSpec, width: float, random: np.random.Generator) -> Iterator[ObstacleSpec]:
    """Yield what stands behind half of the openings: a disc of their width."""
    for opening in corridor.openings:
        if random.random() < 0.5:
            continue
        radius = 0.5 * opening.s.length
        lateral = 0.5 * width + corridor.wall_thickness + random.uniform(*_BEHIND) + radius
        yield _disc(corridor.path, opening.s.centre, lateral if opening.side == "left" else -lateral, radius)


def _disc(path: ArcPath, s: float, lateral: float, radius: float) -> ObstacleSpec:
    x, y, heading = path.pose(s).tolist()
    centre = f"({x - lateral * math.sin(heading):.4f}, {y + lateral * math.cos(heading):.4f}) m"
    return ObstacleSpec.model_validate({"disc": {"centre": centre, "radius": f"{radius:.4f} m"}})

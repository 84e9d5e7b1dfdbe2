"""Worlds with a planned path, and something beside it that the map lacks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from ctrl_rl_navigation.maps import map_file
from ctrl_rl_navigation.robot import limits_of
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap, find_robot
from ctrl_rl_navigation import MapSolver, NavigationError

Array = NDArray[np.float64]

MAPS = ("maze", "warehouse")
ROBOT = "turtlebot3_burger"
_SHORTEST, _LONGEST = 2.5, 7.0
"""Lengths of the paths [m]."""
_SIDE = 0.2
"""Side of the box beside a path [m]."""
_ROOM = 0.08
"""Room beyond the robot's own in which a box leaves a way [m]."""
_TRIES = 200


class PathTrial(NamedTuple):
    """A path in a world.

    Attributes:
        map_file: Map that the planner knows.
        world_file: Map with the box, from which the world is built; the same file without a box.
        path: Positions of the path (n, 2) [m].
        heading: Heading of the robot at the start [rad].
        boxed: Whether a box stands beside the path.
    """

    map_file: Path
    world_file: Path
    path: Array
    heading: float
    boxed: bool


def draw_trial(seed: int, folder: Path) -> PathTrial:
    """Draw a path of the navigator, with a box beside every second one; the map of the world goes to a folder."""
    random, file = np.random.default_rng((seed, 31)), map_file(MAPS[seed // 2 % len(MAPS)])
    map_, limits = OccupancyMap.load(file), limits_of(find_robot(ROBOT))
    solver = MapSolver(map_, limits)
    roomy = np.argwhere(solver.clearance >= limits.room + _ROOM)
    for _ in range(_TRIES):
        start, goal = (map_.cell_to_world(*roomy[random.integers(len(roomy))]) for _ in range(2))
        path = solver.solve((float(goal[0]), float(goal[1])), 0.05).path(start)
        length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
        if not _SHORTEST <= length <= _LONGEST or math.dist(path[-1], goal) > 0.2:
            continue
        heading = random.uniform(-math.pi, math.pi)
        if seed % 2 == 0:
            return PathTrial(file, file, path, heading, False)
        world = _with_box(map_, path, random)
        if world is not None and _is_open(world, path):
            out = folder / f"world_{seed}.yaml"
            world.save(out)
            return PathTrial(file, out, path, heading, True)
    raise AssertionError(f"no path for seed {seed}")


def _with_box(map_: OccupancyMap, path: Array, random: np.random.Generator) -> OccupancyMap | None:
    """Return the map with a box whose edge is 5 to 30 cm beside the path's middle part."""
    i = int(random.uniform(0.3, 0.7) * len(path))
    along = path[min(i + 5, len(path) - 1)] - path[max(i - 5, 0)]
    normal = np.array((-along[1], along[0])) / max(float(np.hypot(*along)), 1e-9)
    away = random.choice((-1.0, 1.0)) * (random.uniform(0.05, 0.3) + 0.5 * _SIDE)
    centre = path[i] + away * normal
    rows, columns = np.indices(map_.cells.shape)
    x, y = np.moveaxis(map_.cell_to_world(rows.ravel(), columns.ravel()), -1, 0)
    box = (np.maximum(np.abs(x - centre[0]), np.abs(y - centre[1])) <= 0.5 * _SIDE).reshape(map_.cells.shape)
    cells = map_.cells.copy()
    cells[box] = 100
    return OccupancyMap(cells, map_.resolution, map_.origin) if box.any() else None


def _is_open(world: OccupancyMap, path: Array) -> bool:
    """Return whether a way with some room leads along the path past the box."""
    limits = limits_of(find_robot(ROBOT), 0.025 + _ROOM)
    solver = MapSolver(world, limits)
    corridor = path, 0.5
    try:
        value = solver.solve((float(path[-1, 0]), float(path[-1, 1])), 0.2, widest=0.3, along=corridor)
    except NavigationError:
        return False
    return bool(np.isfinite(value.value(path[0]))) and float(value.value(path[0])) < 300.0

"""A world as the occupancy map that a robot would build."""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.navigation import FREE, OCCUPIED

from ctrl_rl_core import NavigationTask, OccupancyMap, World

RESOLUTION = 0.05
"""Side length of a cell [m]; larger in very large worlds."""
_MOST_CELLS = 1_000_000
_MARGIN = 0.3


def draw_map(task: NavigationTask, world: World) -> OccupancyMap:
    """Return the map of a world in the x-y plane; cells touched by a wall or obstacle are occupied.

    Args:
        task: Task of the world, which bounds the map.
        world: Walls and obstacles.
    """
    (left, right), (bottom, top) = (task.plane_bounds[name] for name in ("x", "y"))
    left, right, bottom, top = left - _MARGIN, right + _MARGIN, bottom - _MARGIN, top + _MARGIN
    resolution = max(RESOLUTION, math.sqrt((right - left) * (top - bottom) / _MOST_CELLS))
    shape = (math.ceil((top - bottom) / resolution), math.ceil((right - left) / resolution))
    empty = OccupancyMap(np.zeros(shape, np.int8), resolution, (left, bottom, 0.0))
    distance = world.signed_distance(empty.cell_to_world(*np.indices(shape)))
    cells = np.where(distance < 0.5 * resolution, OCCUPIED, FREE).astype(np.int8)
    return OccupancyMap(cells, resolution, empty.origin)

"""Shapes of the scene as arrays: walls, floor, surfaces, and pictures of grids."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from ctrl_rl_core.navigation import FREE, OCCUPIED
from numpy.typing import NDArray

from ctrl_rl_bringup.view.colours import DANGER, UNKNOWN, VALUES, WALL
from ctrl_rl_bringup.view.scene import Array, Grid, Pose, Surface
from ctrl_rl_core import Box, OccupancyMap

Mesh = tuple[Array, NDArray[np.int64]]
"""Vertices (n, 3) [m] and faces (m, 3)."""
Picture = NDArray[np.uint8]
"""Red, green, blue, opacity (rows, columns, 4); row 0 lies at the origin."""
_MOST_PIXELS = 2048
"""Number of rows and of columns of a picture."""
_MOST_BOXES, _MOST_CELLS = 5000, 4_000_000
"""Limits of maps whose walls are raised; the walls of others stay flat."""
_MOST_STEPS = 150
"""Number of rows and of columns of a surface."""
_SCALE = np.array(VALUES, np.float64)
_CORNERS = np.array([(x, y, z) for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)], np.float64)
_SIDES = np.array(
    ((4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (1, 3, 7), (1, 7, 5), (3, 2, 6), (3, 6, 7), (2, 0, 4), (2, 4, 6)),
    np.int64,
)
"""Faces of a box without its underside, seen from outside."""


def quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return the rotation about z by an angle [rad] as a quaternion w, x, y, z."""
    return math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)


def walls_of(map_: OccupancyMap, height: float) -> Mesh | None:
    """Return the walls of a map as one mesh of a height [m]; None where there are none, or too many to raise."""
    if map_.cells.size > _MOST_CELLS:
        return None
    boxes = map_.boxes()
    return boxes_mesh(boxes, height) if 0 < len(boxes) <= _MOST_BOXES else None


def boxes_mesh(boxes: Sequence[Box], height: float) -> Mesh:
    """Return boxes of a height [m] that stand on the floor as one mesh."""
    size = np.array([(*box.size, height) for box in boxes])
    angle = np.array([box.angle for box in boxes])
    corners = _CORNERS * size[:, None, :]
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = corners[..., 0].copy(), corners[..., 1].copy()
    corners[..., 0], corners[..., 1] = c * x - s * y, s * x + c * y
    corners[..., :2] += np.array([box.centre for box in boxes])[:, None, :]
    faces = _SIDES + len(_CORNERS) * np.arange(len(boxes))[:, None, None]
    return corners.reshape(-1, 3), faces.reshape(-1, 3)


def floor_of(map_: OccupancyMap) -> Picture:
    """Return the picture of a map: occupied dark, unknown grey, free cells clear."""
    cells = _thinned(map_.cells)
    out = np.empty((*cells.shape, 4), np.uint8)
    out[...] = (*UNKNOWN, 255)
    out[cells == FREE] = (255, 255, 255, 0)
    out[cells == OCCUPIED] = (*WALL, 255)
    return out


def picture_of(grid: Grid) -> Picture:
    """Return the picture of the filter's set: the less margin, the denser; states that are lost most of all."""
    percent = np.clip(_thinned(grid.percent), 0, 100)
    out = np.empty((*percent.shape, 4), np.uint8)
    out[..., :3] = DANGER
    out[..., 3] = np.where(percent == 100, 150, 0.9 * percent)
    return out


def centre_of(shape: tuple[int, ...], cell: float, origin: Pose) -> tuple[float, float]:
    """Return the middle of a grid (rows, columns) of cells [m] with an outer corner and yaw [m, m, rad]."""
    x, y, yaw = origin
    c, s, half_x, half_y = math.cos(yaw), math.sin(yaw), 0.5 * cell * shape[1], 0.5 * cell * shape[0]
    return x + c * half_x - s * half_y, y + s * half_x + c * half_y


def funnel_of(surface: Surface, depth: float) -> tuple[Mesh, Picture] | None:
    """Return a surface as a mesh and the colours of its vertices (n, 4); None if no value is known.

    Args:
        surface: Heights, 0 at the best value.
        depth: Distance from the floor down to the best value [m]; the worst value lies at the floor.
    """
    step = max(1, math.ceil(max(surface.heights.shape) / _MOST_STEPS))
    heights = surface.heights[::step, ::step]
    rows, columns = heights.shape
    known = np.isfinite(heights)
    number = np.full(heights.shape, -1)
    number[known] = np.arange(np.count_nonzero(known))
    corners = np.stack((number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]), axis=-1).reshape(-1, 4)
    corners = corners[(corners >= 0).all(axis=1)]
    if not len(corners):
        return None
    x0, y0, yaw = surface.origin
    c, s, cell = math.cos(yaw), math.sin(yaw), step * surface.cell
    across, along = np.meshgrid(cell * np.arange(columns), cell * np.arange(rows))
    x, y = x0 + c * across - s * along, y0 + s * across + c * along
    vertices = np.column_stack((x[known], y[known], depth * (heights[known] - 1.0)))
    faces = np.concatenate((corners[:, :3], corners[:, (0, 2, 3)]))
    return (vertices, faces), _colours(1.0 - heights[known])


def _colours(goodness: Array) -> Picture:
    """Return the colours (n, 4) of values from 0, the worst, to 1 (n,)."""
    place = np.clip(goodness, 0.0, 1.0) * (len(_SCALE) - 1)
    out = np.full((len(place), 4), 255, np.uint8)
    for channel in range(3):
        out[:, channel] = np.interp(place, np.arange(len(_SCALE)), _SCALE[:, channel])
    return out


def segments_of(points: Array, height: float) -> NDArray[np.float32]:
    """Return the segments (n - 1, 2, 3) of a line through points (n, 2) at a height [m]."""
    raised = np.column_stack((points, np.full(len(points), height))).astype(np.float32)
    return np.stack((raised[:-1], raised[1:]), axis=1)


def _thinned(cells: NDArray[np.int8]) -> NDArray[np.int8]:
    step = max(1, math.ceil(max(cells.shape) / _MOST_PIXELS))
    return cells[::step, ::step]

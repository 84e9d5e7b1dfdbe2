"""Clearance from a task's walls and obstacles at the nodes, and a check that the grid resolves them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, Box, Disc, Interval, Shape, signed_distance
from ttr_reward_node.errors import TimeToReachError

Array = NDArray[np.float64]
_SPARE = 1.05  # margin for rounding


def make_clearance(
    shapes: Sequence[Shape], arena: Sequence[Interval] | None, axes: Sequence[Axis], inflation: float
) -> NDArray[np.float32]:
    """Return the distance to the nearest obstacle at the nodes of two axes, shape (count, count) [m].

    Args:
        shapes: Walls and obstacles that paths must not pass through.
        arena: Intervals outside of which everything is solid [m], so that its walls need no thickness; None for no
            arena.
        axes: Two axes of the plane of positions.
        inflation: Distance by which walls and obstacles are inflated [m].

    Raises:
        TimeToReachError: A shape is thinner than a cell, so that nodes on either side of it can be neighbours.
    """
    points = np.stack(np.meshgrid(*(axis.nodes for axis in axes), indexing="ij"), axis=-1)
    _check_thickness(shapes, axes, points, inflation)
    distance = signed_distance(shapes, points)
    if arena is not None:
        for k, side in enumerate(arena):
            distance = np.minimum(distance, np.minimum(points[..., k] - side.low, side.high - points[..., k]))
    return (distance - inflation).astype(np.float32)


def _check_thickness(shapes: Sequence[Shape], axes: Sequence[Axis], points: Array, inflation: float) -> None:
    spacings = [axis.spacing for axis in axes]
    lacking, thinnest = 0.0, 0.0
    for shape in shapes:
        for thickness, cell in _thicknesses(shape, spacings):
            lack = _SPARE * cell - thickness - 2.0 * inflation
            # Ignore shapes outside the grid.
            if lack > lacking and np.any(shape.signed_distance(points) <= math.hypot(*spacings)):
                lacking, thinnest = lack, thickness
    if lacking > 0.0:
        enough = math.ceil(1e3 * (inflation + 0.5 * lacking)) / 1e3
        raise TimeToReachError(
            f"walls or obstacles of {thinnest:.3g} m are too thin for cells of {max(spacings):.3g} m, paths would leak "
            f"through: give an inflation of {enough:g} m or more, or more nodes"
        )


def _thicknesses(shape: Shape, spacings: Sequence[float]) -> list[tuple[float, float]]:
    """Return the thickness of a shape along its own directions, and the extent of a cell along each [m]."""
    if isinstance(shape, Disc):
        return [(2.0 * shape.radius, math.hypot(*spacings))]
    assert isinstance(shape, Box)
    c, s = abs(math.cos(shape.angle)), abs(math.sin(shape.angle))
    first, second = spacings
    return [(shape.size[0], c * first + s * second), (shape.size[1], s * first + c * second)]

"""Compiled entries of the table of steps: ends, ranges and reach of each step, and whether it leaves the limits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.held_steps import Array, Starts, compiled
from ttr_reward_node.kernels.stencil import PER_CELL

_OPTIONS = {"error_model": "numpy"}
_GRAZE = 0.25  # distance that a path may extend beyond a node without leaving it [cells]
_EDGE = 1e-3  # rounding error of a step truncated at a limit [cells]
_FARTHEST = 127.0  # largest reach that 8 bits hold [cells]; a step has up to 15 cells
PARTS = 8
"""Number of straight segments that approximate the path of a step."""


class Paths(NamedTuple):
    """Paths of m steps as cubic Hermite curves: as accurate as the steps, without further evaluations of the system.

    Attributes:
        h: Durations (m,) [s]; 0 if nothing moves, or the derivatives are not finite.
        move: Displacements at the end (n, m) [cells]; 0 without a step.
        first, last: Rates at the start and at the end (n, m) [cells/s].
    """

    h: Array
    move: Array
    first: Array
    last: Array


class Limits(NamedTuple):
    """Limits of the states.

    Attributes:
        low, high: Lowest and highest state (n,); infinite along an axis at which no step is truncated.
        place: Position of each axis in the layout's order (n,).
        outer: Number of outer axes.
    """

    low: Array
    high: Array
    place: NDArray[np.int64]
    outer: int


class Tables(NamedTuple):
    """Tables of all steps: disturbances vary slowest, then lengths, then controls; axes in the layout's order.

    Attributes:
        ends: Displacements (slabs, disturbances, lengths, controls, n) [1 / PER_CELL cells].
        ranges: Lowest and highest cell along each inner axis (slabs, disturbances, lengths, controls, inner, 2).
        reach: Lowest and highest cell along each axis over all steps of a slab (slabs, n, 2).
    """

    ends: NDArray[np.int16]
    ranges: NDArray[np.int8]
    reach: NDArray[np.int8]


@compiled
def enter_steps(starts: Starts, paths: Paths, limits: Limits, first_slab: int, length: int, tables: Tables) -> None:
    """Enter the steps of one length from consecutive slabs; those that leave the limits get the duration 0.

    A step that starts beyond a limit, at the node next to it, only has to end within the limits.
    """
    x, below, above, _, _, spacings = starts
    h, move, first, last = paths
    low, high, place, outer = limits
    ends, ranges, reach = tables
    disturbances, controls = ends.shape[1], ends.shape[3]
    pairs = disturbances * controls
    n, m = x.shape
    for e in range(m):
        slab, disturbance, control = first_slab + e // pairs, e % pairs // controls, e % controls
        third = h[e] / 3.0
        doubtful, outside = False, False
        for k in range(n):
            at, end = place[k], move[k, e]
            ends[slab, disturbance, length, control, at] = np.int16(np.rint(end * PER_CELL))
            lowest, highest = 0.0, 0.0
            if h[e] > 0.0:
                one, two = third * first[k, e], end - third * last[k, e]
                lowest, highest = min(min(0.0, one), min(two, end)), max(max(0.0, one), max(two, end))
            doubtful |= lowest < -below[k, e] - 0.5 * _EDGE or highest > above[k, e] + 0.5 * _EDGE
            outside |= _beyond(x[k, e] + spacings[k] * end, low[k], high[k], spacings[k])
            reach[slab, at, 0] = min(reach[slab, at, 0], np.int8(np.floor(max(lowest, -_FARTHEST))))
            reach[slab, at, 1] = max(reach[slab, at, 1], np.int8(np.ceil(min(highest, _FARTHEST))))
            if at >= outer:
                least, most = _range_along(paths, k, e)
                ranges[slab, disturbance, length, control, at - outer, 0] = np.int8(np.floor(least + _GRAZE))
                ranges[slab, disturbance, length, control, at - outer, 1] = np.int8(np.ceil(most - _GRAZE))
        if outside or (doubtful and _path_leaves(starts, paths, limits, e)):
            h[e] = 0.0


@njit(**_OPTIONS)
def _beyond(x: float, low: float, high: float, spacing: float) -> bool:
    return x < low - _EDGE * spacing or x > high + _EDGE * spacing


@njit(**_OPTIONS)
def _range_along(paths: Paths, k: int, e: int) -> tuple[float, float]:
    """Return the lowest and highest displacement of step e along axis k [cells], at most and at least 0."""
    least, most = 0.0, 0.0
    for part in range(1, PARTS + 1):
        way = displacement(paths, k, e, part)
        least, most = min(least, way), max(most, way)
    return least, most


@njit(**_OPTIONS)
def displacement(paths: Paths, k: int, e: int, part: int) -> float:
    """Return the displacement of step e along axis k after `part` of PARTS parts of its duration [cells]."""
    if part == PARTS:
        return paths.move[k, e]
    s = part / PARTS
    bend = paths.h[e] * s * (1.0 - s) * ((1.0 - s) * paths.first[k, e] - s * paths.last[k, e])
    return s * s * (3.0 - 2.0 * s) * paths.move[k, e] + bend


@njit(**_OPTIONS)
def _path_leaves(starts: Starts, paths: Paths, limits: Limits, e: int) -> bool:
    for k in range(len(limits.low)):
        low, high, spacing, start = limits.low[k], limits.high[k], starts.spacings[k], starts.x[k, e]
        begin = PARTS if _beyond(start, low, high, spacing) else 1
        for part in range(begin, PARTS + 1):
            if _beyond(start + spacing * displacement(paths, k, e, part), low, high, spacing):
                return True
    return False


@compiled
def trace_paths(paths: Paths, place: NDArray[np.int64], pairs: int, out: NDArray[np.float32]) -> None:
    """Set `out` (k, pairs, PARTS, n) to the displacements after each part [cells], axes in the layout's order.

    They are 0 where there is no step.
    """
    n, m = paths.move.shape
    for e in range(m):
        for k in range(n):
            for part in range(1, PARTS + 1):
                way = displacement(paths, k, e, part) if paths.h[e] > 0.0 else 0.0
                out[e // pairs, e % pairs, part - 1, place[k]] = way

"""Fast marching: solves |grad T| = slowness on a grid, cell by cell in the order of arrival times.

The stencils are second-order if two known cells lie in a row, else first-order (J. A. Sethian, Fast marching methods,
SIAM Review 41, 1999). Arrays are flat, with an impassable border of two cells.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

BORDER = 2
"""Width of the border around the map [cells], given by the reach of the stencils."""
_FAR, _KNOWN = 0, 1
_LAYER = 1e7
"""Time that no goal is away [s]: it separates steps in the queue's order."""


class Front(NamedTuple):
    """State of fast marching.

    Attributes:
        times: Times to reach (cells,) [s]; inf if unknown.
        slowness: Time to cross a cell (cells,) [s]; 0 for impassable cells.
        known: 1 for cells with a final time (cells,).
        hops: Number of steps from the open cells to those entered since `widen` (cells,).
        keys: Order of the binary heap's entries (capacity,) [s]: times, and `_LAYER` for each step since `widen`.
        cells: Cells of the heap's entries (capacity,).
        counts: Number of heap entries, and of known cells (2,).
        stride: Row stride in memory.
    """

    times: NDArray[np.float64]
    slowness: NDArray[np.float64]
    known: NDArray[np.uint8]
    hops: NDArray[np.uint8]
    keys: NDArray[np.float64]
    cells: NDArray[np.int64]
    counts: NDArray[np.int64]
    stride: int


def make_front(slowness: NDArray[np.float64]) -> Front:
    """Create a front before its first cell.

    Args:
        slowness: Time to cross a cell (rows, columns) [s]; 0 for impassable cells.
    """
    padded = np.pad(slowness, BORDER)
    count = padded.size
    room = 4 * count + 16  # each neighbour may push a cell once
    return Front(
        np.full(count, np.inf),
        padded.ravel(),
        np.full(count, _FAR, np.uint8),
        np.zeros(count, np.uint8),
        np.empty(room),
        np.empty(room, np.int64),
        np.zeros(2, np.int64),
        padded.shape[1],
    )


@njit(inline="always")
def _push(front: Any, key: float, cell: int) -> None:
    keys, cells = front.keys, front.cells
    place = front.counts[0]
    front.counts[0] += 1
    while place > 0:
        above = (place - 1) >> 1
        if keys[above] <= key:
            break
        keys[place], cells[place] = keys[above], cells[above]
        place = above
    keys[place], cells[place] = key, cell


@njit(inline="always")
def _pop(front: Any) -> int:
    keys, cells = front.keys, front.cells
    first = cells[0]
    front.counts[0] -= 1
    size = front.counts[0]
    key, cell = keys[size], cells[size]
    place = 0
    while True:
        below = 2 * place + 1
        if below >= size:
            break
        if below + 1 < size and keys[below + 1] < keys[below]:
            below += 1
        if keys[below] >= key:
            break
        keys[place], cells[place] = keys[below], cells[below]
        place = below
    keys[place], cells[place] = key, cell
    return first


@njit(inline="always")
def _upwind(front: Any, cell: int, step: int) -> tuple[float, float]:
    """Return the upwind time along an axis, inf for none, and the weight of its quadratic term."""
    times, known = front.times, front.known
    best, side = np.inf, 0
    for sign in (-1, 1):
        other = cell + sign * step
        if known[other] == _KNOWN and times[other] < best:
            best, side = times[other], sign
    if side == 0:
        return np.inf, 1.0
    beyond = cell + 2 * side * step
    if known[beyond] == _KNOWN and times[beyond] <= best:
        return (4.0 * best - times[beyond]) / 3.0, 2.25
    return best, 1.0


@njit(inline="always")
def _time(front: Any, cell: int) -> float:
    """Return the time of a cell from its known neighbours."""
    s = front.slowness[cell]
    a, p = _upwind(front, cell, 1)
    b, q = _upwind(front, cell, front.stride)
    one = min(a + s / np.sqrt(p), b + s / np.sqrt(q))
    if a == np.inf or b == np.inf:
        return one
    mean = (p * a + q * b) / (p + q)
    root = s * s / (p + q) - p * q * (a - b) * (a - b) / ((p + q) * (p + q))
    if root < 0.0:
        return one
    both = mean + np.sqrt(root)
    return both if both >= max(a, b) else one


@njit(inline="always")
def _offer(front: Any, cell: int, hops: int) -> None:
    """Recompute the time of a cell, and queue the cell if the time decreased, or fewer steps lead there."""
    if front.slowness[cell] <= 0.0 or front.known[cell] == _KNOWN:
        return
    if front.times[cell] < np.inf and hops > front.hops[cell]:
        return
    time = _time(front, cell)
    if time < front.times[cell] or hops < front.hops[cell]:
        front.times[cell] = time
        front.hops[cell] = hops
        _push(front, time + hops * _LAYER, cell)


def _seed(front: Any, cells: NDArray[np.int64], times: NDArray[np.float64]) -> None:
    for i in range(cells.size):
        if front.slowness[cells[i]] > 0.0 and times[i] < front.times[cells[i]]:
            front.times[cells[i]] = times[i]
            _push(front, times[i], cells[i])


seed = cached_njit(_seed, nogil=True)
"""Queue cells (n,) with given times (n,) [s]."""


def _march(front: Any, most: int, deepest: int) -> int:
    stride = front.stride
    done = 0
    while front.counts[0] > 0 and done < most:
        cell = _pop(front)
        if front.known[cell] == _KNOWN:
            continue
        front.known[cell] = _KNOWN
        done += 1
        hops = front.hops[cell]
        if deepest > 0:
            if hops >= deepest:
                continue
            hops += 1
        for step in (-1, 1, -stride, stride):
            _offer(front, cell + step, hops)
    front.counts[1] += done
    return front.counts[0]


march = cached_njit(_march, nogil=True)
"""Finalise up to `most` more cells and return the queue length; 0 means that all reachable cells are known.

Of the cells opened by `widen`, only those within `deepest` steps are entered; 0 for all. They are entered step by step,
not in the order of times: else a short time would enter a gap that is too tight for the robot, come out of it on the
other side, and lead the robot there into the gap."""


def _widen(front: Any, slowness: NDArray[np.float64]) -> None:
    for cell in range(slowness.size):
        if front.known[cell] != _KNOWN:
            front.slowness[cell] = slowness[cell]
    stride = front.stride
    for cell in range(2 * stride, slowness.size - 2 * stride):
        if front.known[cell] != _KNOWN and front.slowness[cell] > 0.0:
            near = front.known[cell - 1] + front.known[cell + 1]
            if near + front.known[cell - stride] + front.known[cell + stride] > 0:
                _offer(front, cell, 1)


widen = cached_njit(_widen, nogil=True)
"""Open further cells to a finished march, by their times to cross (cells,) [s]; known cells keep theirs."""

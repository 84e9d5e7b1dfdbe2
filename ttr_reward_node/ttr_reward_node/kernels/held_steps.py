"""Compiled arithmetic of steps under a constant control, between the evaluations of the system's derivatives.

The derivatives are NumPy functions of the user, evaluated for a block of steps at once; everything in between takes one
pass over the block. Each component of a state has an array of its own, so that the compiler vectorises the loops.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
_OPTIONS = {"error_model": "numpy"}
_INLINE = {"error_model": "numpy", "forceinline": True}

_BENT = 0.5  # largest correction by the second stage of an accepted Runge-Kutta step [cells]
_SPEED_UP = 4.0  # largest factor by which a correction prolongs a step
_NUDGE = 0.2  # an end closer to its plane than this is moved onto it along the final rate [cells]
_FAR = 0.1  # an end farther from its plane than this is recomputed, relative to the step length
_SNAP = 1e-4  # displacements closer than this to whole cells are rounded [cells]
_NO_ROOM = 1e-6  # distance to a limit below which a step starts on it [cells]
DONE, AGAIN, LOST = np.uint8(0), np.uint8(1), np.uint8(2)
"""State of a step: accepted, to be recomputed because its end is far from its plane, or because it is inaccurate."""


def compiled(function: Callable[..., None]) -> Callable[..., None]:
    """Compile a function that NumPy code calls; it releases the GIL, and its code is kept on disk."""
    return cached_njit(function, nogil=True, **_OPTIONS)


class Starts(NamedTuple):
    """Start of each of m steps.

    Attributes:
        x: States (n, m).
        below, above: Distances to the limits at which a step is truncated (n, m) [cells]; infinite without a limit.
        first: Rates (n, m) [cells/s].
        longest: Maximum durations (m,) [s].
        spacings: Spacing of each axis (n,), in its unit.
    """

    x: Array
    below: Array
    above: Array
    first: Array
    longest: Array
    spacings: Array


@compiled
def guess_durations(starts: Starts, cells: float, h: Array, stage: Array) -> None:
    """Set durations h (m,) [s] by the initial rates, and `stage` (n, m) to the states at half of them.

    The duration is 0 where nothing moves or a rate is not finite.
    """
    x, _, _, first, longest, spacings = starts
    n, m = x.shape
    h[:] = 0.0
    for k in range(n):
        rate = first[k]
        for e in range(m):
            speed = abs(rate[e])
            h[e] = speed if speed > h[e] or speed != speed else h[e]
    for e in range(m):
        moves = 0.0 < h[e] < np.inf
        h[e] = min(cells / h[e], longest[e]) if moves else 0.0
    go_half(x, first, spacings, h, stage)


@compiled
def improve_durations(starts: Starts, half: Array, cells: float, h: Array, stage: Array, work: Array) -> None:
    """Correct durations by the rates at half of them, `half` (n, m) [cells/s]; other arguments as before."""
    x, below, above, first, longest, spacings = starts
    n, m = x.shape
    work[:] = np.inf
    for k in range(n):
        rate, down, up = half[k], below[k], above[k]
        for e in range(m):
            ratio = _ratio(h[e] * rate[e], down[e], up[e], cells)
            work[e] = ratio if ratio < work[e] or ratio != ratio else work[e]
    for e in range(m):
        h[e] = min(h[e] * work[e] if work[e] < _SPEED_UP else h[e], longest[e])
    go_half(x, first, spacings, h, stage)


@compiled
def correct_durations(
    starts: Starts, move: Array, cells: float, state: NDArray[np.uint8], h: Array, stage: Array, work: Array
) -> None:
    """Correct durations by the displacements `move` (n, m) [cells]; halve those of inaccurate steps, by `state` (m,).

    An inaccurate step is not prolonged again: its maximum duration is reduced.
    """
    x, below, above, first, longest, spacings = starts
    for e in range(len(h)):
        longest[e] = 0.5 * h[e] if state[e] == LOST else longest[e]
    _ratios(move, below, above, cells, work)
    for e in range(len(h)):
        halve = state[e] == LOST or work[e] != work[e]
        h[e] = min(0.5 * h[e] if halve else h[e] * min(work[e], _SPEED_UP), longest[e])
    go_half(x, first, spacings, h, stage)


@compiled
def go_half(x: Array, first: Array, spacings: Array, h: Array, stage: Array) -> None:
    """Set `stage` (n, m) to the states after half of the durations h (m,) at the initial rates."""
    for k in range(len(x)):
        start, rate, out, spacing = x[k], first[k], stage[k], spacings[k]
        for e in range(len(h)):
            out[e] = start[e] + 0.5 * h[e] * spacing * rate[e]


@compiled
def third_stage(x: Array, second: Array, h: Array, stage: Array) -> None:
    """Set `stage` (n, m) for the third Runge-Kutta stage; `second` (n, m) are the derivatives of the second."""
    for k in range(len(x)):
        start, rate, out = x[k], second[k], stage[k]
        for e in range(len(h)):
            out[e] = start[e] + 0.5 * h[e] * rate[e]


@compiled
def fourth_stage(x: Array, second: Array, third: Array, spacings: Array, h: Array, stage: Array, bent: Array) -> None:
    """Set `stage` (n, m) for the fourth stage, add the third derivatives to `second`, and estimate the error.

    The second and third stages agree if the path is smooth over the step: their difference `bent` (m,) [cells] is an
    error estimate for free; NaN if a derivative is.
    """
    bent[:] = 0.0
    for k in range(len(x)):
        start, two, three, out, spacing = x[k], second[k], third[k], stage[k], spacings[k]
        for e in range(len(h)):
            off = abs((three[e] - two[e]) / spacing)
            bent[e] = off if off > bent[e] or off != off else bent[e]
            out[e] = start[e] + h[e] * three[e]
            two[e] += three[e]
    for e in range(len(h)):
        bent[e] *= h[e]


@compiled
def finish_step(
    starts: Starts,
    middle: Array,
    fourth: Array,
    cells: float,
    h: Array,
    bent: Array,
    move: Array,
    stage: Array,
    state: NDArray[np.uint8],
    work: Array,
) -> None:
    """Set displacements `move` (n, m) [cells], final states `stage` (n, m), and whether each step is accepted (m,).

    `middle` (n, m) is the sum of the second and third derivatives, `bent` (m,) the error estimate.
    """
    x, below, above, first, longest, spacings = starts
    for k in range(len(x)):
        start, two, four, one, out, end, spacing = x[k], middle[k], fourth[k], first[k], move[k], stage[k], spacings[k]
        for e in range(len(h)):
            out[e] = h[e] / 6.0 * (one[e] + (2.0 * two[e] + four[e]) / spacing)
            end[e] = start[e] + out[e] * spacing
            bent[e] += 0.0 * out[e]  # NaN if the displacement is not finite
    _ratios(move, below, above, cells, work)
    for e in range(len(h)):
        lost = not bent[e] <= _BENT and h[e] > 0.0
        missing = work[e] - 1.0
        far = abs(missing) > _FAR and h[e] > 0.0 and not (missing > 0.0 and h[e] >= longest[e])
        state[e] = LOST if lost else (AGAIN if far else DONE)


@compiled
def onto_planes(starts: Starts, cells: float, last: Array, h: Array, move: Array, work: Array, way: Array) -> None:
    """Move ends that are close to a plane of the grid onto it, which saves interpolation along that axis.

    `last` (n, m) [cells/s] are the final rates. Steps with infinite or NaN results get the duration 0.
    """
    _, below, above, _, _, _ = starts
    _ratios(move, below, above, cells, work)
    way[:] = 0.0
    for k in range(len(move)):
        out = move[k]
        for e in range(len(h)):
            way[e] = max(way[e], abs(out[e]))
    for e in range(len(h)):
        missing = work[e] - 1.0
        near = np.isfinite(missing) and abs(missing) * way[e] < _NUDGE and h[e] > 0.0
        work[e] = missing * h[e] if near else 0.0
        way[e] = 0.0
    for k in range(len(move)):
        out, rate = move[k], last[k]
        for e in range(len(h)):
            end = out[e] + work[e] * rate[e]
            whole = np.rint(end)
            out[e] = whole if abs(end - whole) < _SNAP else end
            way[e] += 0.0 * out[e] + 0.0 * rate[e]  # NaN unless both are finite
    for e in range(len(h)):
        if way[e] == 0.0 and h[e] > 0.0:
            h[e] += work[e]
        else:
            h[e] = 0.0
            move[:, e] = 0.0


@njit(**_OPTIONS)
def _ratios(move: Array, below: Array, above: Array, cells: float, out: Array) -> None:
    """Set `out` (m,) to the factors by which displacements must grow to reach their plane or the first limit before."""
    out[:] = np.inf
    for k in range(len(move)):
        way, down, up = move[k], below[k], above[k]
        for e in range(len(out)):
            ratio = _ratio(way[e], down[e], up[e], cells)
            out[e] = ratio if ratio < out[e] or ratio != ratio else out[e]


@njit(**_INLINE)
def _ratio(move: float, below: float, above: float, cells: float) -> float:
    room = below if move < 0.0 else above
    # A step outwards from a limit has no room: it keeps its length, and is rejected later because of its end.
    return (cells if room < _NO_ROOM else min(room, cells)) / abs(move)

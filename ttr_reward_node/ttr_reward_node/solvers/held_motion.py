"""Motion of a system under a constant control until it has moved a given number of cells.

The semi-Lagrangian scheme fixes the length of a step on the grid, not its duration: a slow state gets as much time as
it needs. So the accuracy of a step does not depend on how much faster the system moves elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import System

Array = NDArray[np.float64]

_ROOM_OF_DISTURBANCE = 0.5  # displacement by disturbances up to which a slow pair may continue, per step length
_BENT = 0.5  # largest correction by the second stage of an accepted Runge-Kutta step [cells]
_HALVINGS = 40  # maximum number; a step that is still not smooth gets the duration 0
_SPEED_UP = 4.0  # largest factor by which a correction prolongs a step
_NUDGE = 0.2  # an end closer to its plane than this is moved onto it along the final rate [cells]
_FAR = 0.1  # an end farther from its plane than this is recomputed, relative to the step length
_CORRECTIONS = 2  # number of such corrections of the duration
_SNAP = 1e-4  # displacements closer than this to whole cells are rounded [cells]


class HeldPairs(NamedTuple):
    """Controls and disturbances held constant during a step.

    Attributes:
        u: Controls (pairs, m).
        d: Disturbances (pairs, n).
    """

    u: Array
    d: Array


class Room(NamedTuple):
    """Free space around the start states of steps.

    Attributes:
        below, above: Distances (k, 1, n) [cells] to the limits at which a step is truncated; infinite without a limit.
    """

    below: Array
    above: Array


@dataclass(frozen=True, eq=False)
class Motion:
    """Paths of k states under p pairs.

    Attributes:
        durations: Durations (k, p) [s]; 0 if nothing moves, or the derivatives are not finite.
        moves: Displacements at the end (k, p, n) [cells]; 0 without a step.
        first, last: Rates at the start and at the end (k, p, n) [cells/s].
    """

    durations: Array
    moves: Array
    first: Array
    last: Array

    def path(self, parts: int) -> Array:
        """Return displacements (k, p, parts, n) [cells] after each part of the duration.

        Uses cubic Hermite interpolation between the two ends: as accurate as the step, without further evaluations of
        the system.
        """
        out = np.empty((*self.moves.shape[:-1], parts, self.moves.shape[-1]))
        h = self.durations[..., None]
        for i in range(1, parts):
            s = i / parts
            bend = h * s * (1.0 - s) * ((1.0 - s) * self.first - s * self.last)
            out[..., i - 1, :] = s * s * (3.0 - 2.0 * s) * self.moves + bend
        out[..., -1, :] = self.moves
        return out

    def hull(self) -> tuple[Array, Array]:
        """Return the lower and upper corners (k, p, n) [cells] of the bounding box of each path's control points."""
        third = self.durations[..., None] / 3.0
        points = third * self.first, self.moves - third * self.last, self.moves
        return reduce(np.minimum, points, np.zeros(1)), reduce(np.maximum, points, np.zeros(1))

    def of(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> Motion:
        """Return the motion of selected states under selected pairs, with shape (m,) in place of (k, p)."""
        return Motion(*(each[row, column] for each in (self.durations, self.moves, self.first, self.last)))

    def along(self, axes: tuple[int, ...]) -> Motion:
        """Return the motion along some of the axes."""
        return Motion(self.durations, *(each[..., axes] for each in (self.moves, self.first, self.last)))


def move_cells(
    system: System,
    x: Array,
    pairs: HeldPairs,
    spacings: Array,
    room: Room,
    cells: float,
    patience: float | None = None,
    controls: int = 1,
) -> Motion:
    """Return the paths of states until they have moved `cells` along their fastest axis, or to a limit.

    A step is also shortened if a fourth-order Runge-Kutta step would be inaccurate, e.g. on a circle smaller than a
    cell.

    Args:
        system: System to simulate.
        x: Start states (k, 1, n).
        pairs: Controls and disturbances of the p pairs.
        spacings: Spacing of each axis (n,), in its unit.
        room: Distances to the limits.
        cells: Length of the steps [cells].
        patience: Maximum duration of the steps of a state, as a multiple of that of its fastest pair, unless the
            disturbances have little effect in that time.
        controls: Number of controls; the control is the fastest-varying index of the pairs.
    """
    first = _rates(system, x, pairs, spacings)
    fastest = _over_axes(np.maximum, np.abs(first))
    moving = np.isfinite(fastest) & (fastest > 0.0)
    h = np.where(moving, cells / np.where(moving, fastest, 1.0), 0.0)
    longest = np.full((len(x), 1), np.inf)
    if patience is not None:
        # Knowing how long the opponent holds its input is an advantage: as much as the opponent could do in that time.
        finite = np.where(moving[..., None], first, 0.0).reshape(len(x), -1, controls, first.shape[-1])
        spread = np.ptp(finite, axis=1).max(axis=(-2, -1))[:, None]
        quickest = np.where(moving, fastest, 0.0).max(axis=1, keepdims=True)
        with np.errstate(divide="ignore"):
            longest = cells * np.maximum(patience / quickest, _ROOM_OF_DISTURBANCE / spread)
        h = np.minimum(h, longest)
    # The rate at the midpoint gives a good initial guess of the duration.
    half = _rates(system, x + (0.5 * h[..., None] * spacings) * first, pairs, spacings)
    with np.errstate(invalid="ignore", over="ignore"):
        scale = _fraction_to_limit(h[..., None] * half, room, cells)
        h = np.minimum(np.where(scale < _SPEED_UP, h * scale, h), longest)
    move, lost = _runge_kutta(system, x, pairs, spacings, h, first)
    missing = _fraction_to_limit(move, room, cells) - 1.0
    again = lost | ((np.abs(missing) > _FAR) & (h > 0.0) & ~((missing > 0.0) & (h >= longest)))
    if again.any():
        _adjust(
            system, x, pairs, spacings, room, (h, move, first), (again, lost), np.broadcast_to(longest, h.shape), cells
        )
    last = _rates(system, x + move * spacings, pairs, spacings)
    return _onto_plane(Motion(h, move, first, last), room, cells)


def move_for(system: System, x: Array, pairs: HeldPairs, spacings: Array, durations: Array) -> Motion:
    """Return the paths of states (k, 1, n) for given durations (k, p) [s]."""
    first = _rates(system, x, pairs, spacings)
    move, _ = _runge_kutta(system, x, pairs, spacings, durations, first)
    return Motion(durations, move, first, _rates(system, x + move * spacings, pairs, spacings))


def _fraction_to_limit(move: Array, room: Room, cells: float) -> Array:
    """Return the factor by which a displacement (k, p, n) must grow to reach its plane or the first limit before it."""
    # A step outwards from a limit has no room: it keeps its length, and is rejected later because of its end.
    below, above = (np.where(way < 1e-6, cells, np.minimum(way, cells)) for way in room)
    with np.errstate(divide="ignore", invalid="ignore"):
        return _over_axes(np.minimum, np.where(move < 0.0, below, above) / np.abs(move))


def _onto_plane(motion: Motion, room: Room, cells: float) -> Motion:
    """Move ends that are close to a plane of the grid onto it, which saves interpolation along that axis."""
    move, h = motion.moves, motion.durations
    with np.errstate(invalid="ignore", over="ignore"):
        missing = _fraction_to_limit(move, room, cells) - 1.0
        way = _over_axes(np.maximum, np.abs(move))
        near = np.isfinite(missing) & (np.abs(missing) * way < _NUDGE) & (h > 0.0)
        more = np.where(near, missing * h, 0.0)
        move = move + more[..., None] * motion.last
    whole = np.round(move)
    move = np.where(np.abs(move - whole) < _SNAP, whole, move)
    good = _over_axes(np.logical_and, np.isfinite(move) & np.isfinite(motion.last)) & (h > 0.0)
    return Motion(np.where(good, h + more, 0.0), np.where(good[..., None], move, 0.0), motion.first, motion.last)


def _adjust(
    system: System,
    x: Array,
    pairs: HeldPairs,
    spacings: Array,
    room: Room,
    step: tuple[Array, Array, Array],
    which: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    longest: Array,
    cells: float,
) -> None:
    """Correct, in place, steps that end far from their plane or are inaccurate; set those that stay inaccurate to 0.

    `step` holds durations (k, p) [s], displacements (k, p, n) [cells] and initial rates (k, p, n) [cells/s]; `which`
    marks the steps to correct, and the inaccurate ones among them (k, p); `longest` (k, p) are maximum durations [s].
    """
    h, move, first = step
    row, column = np.nonzero(which[0])
    longest, lost = longest[row, column], which[1][row, column]
    below, above = (np.broadcast_to(each, (len(x), 1, x.shape[-1]))[row, 0] for each in (room.below, room.above))
    for turn in range(_HALVINGS):
        now = h[row, column]
        longest = np.where(lost, 0.5 * now, longest)  # an inaccurate step is not prolonged again
        scale = np.minimum(_fraction_to_limit(move[row, column], Room(below, above), cells), _SPEED_UP)
        now = np.minimum(np.where(lost | ~np.isfinite(scale), 0.5 * now, now * scale), longest)
        some = HeldPairs(pairs.u[column], pairs.d[column])
        found, lost = _runge_kutta(system, x[row, 0], some, spacings, now, first[row, column])
        h[row, column], move[row, column] = now, found
        open_ = lost | (turn < _CORRECTIONS)
        if not open_.any():
            return
        row, column, longest, lost = row[open_], column[open_], longest[open_], lost[open_]
        below, above = below[open_], above[open_]
    h[row, column], move[row, column] = 0.0, 0.0


def _rates(system: System, x: Array, pairs: HeldPairs, spacings: Array) -> Array:
    """Return rates (k, p, n) [cells/s], NaN or infinite if the derivatives are."""
    with np.errstate(all="ignore"):
        rates = system.dynamics(x, *pairs) / spacings
    return np.broadcast_to(rates, (len(x), len(pairs.u), rates.shape[-1]))


def _runge_kutta(
    system: System, x: Array, pairs: HeldPairs, spacings: Array, h: Array, first: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return displacements [cells] by one classical Runge-Kutta step, and whether each step is inaccurate.

    The second and third stages agree if the path is smooth over the step: their difference is an error estimate for
    free.
    """
    dt = h[..., None]
    with np.errstate(all="ignore"):  # a trial step may end where the equations are undefined
        k2 = system.dynamics(x + (0.5 * dt * spacings) * first, *pairs)
        k3 = system.dynamics(x + 0.5 * dt * k2, *pairs)
        k4 = system.dynamics(x + dt * k3, *pairs)
        bent = _over_axes(np.maximum, np.abs((k3 - k2) / spacings)) * h
        k2 += k3
        move = dt / 6.0 * (first + (2.0 * k2 + k4) / spacings)
        lost = ~(_over_axes(np.logical_and, np.isfinite(move)) & (bent <= _BENT))
    return move, lost & (h > 0.0)


def _over_axes(combine: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
    """Reduce values (..., n) over the n axes; for so few, several times faster than NumPy's own reduction."""
    return np.asarray(reduce(combine, (values[..., k] for k in range(values.shape[-1]))))

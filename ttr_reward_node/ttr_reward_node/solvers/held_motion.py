"""Motion of a system under a held control, until it has moved a given number of cells.

The semi-Lagrangian scheme sets the length of a step on the grid, not its duration: a slow state gets as much time as
it needs. So the validity of a step does not depend on how much faster the system moves elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import System

Array = NDArray[np.float64]

_ROOM_OF_DISTURBANCE = 0.5  # of a step's length: what disturbances may change at its end, where the others wait
_BENT = 0.5  # cells: largest effect of the second stage's correction in a Runge-Kutta step that is trusted
_HALVINGS = 40  # at most; the duration of a step that is still not smooth then is set to 0
_SPEED_UP = 4.0  # largest factor by which the correction of a duration prolongs a step
_NUDGE = 0.2  # cells: a step that ends this near to its plane is moved onto it along its last rate
_FAR = 0.1  # of its length: a step whose end is farther from its plane than this is computed again
_CORRECTIONS = 2  # of the durations of such steps
_SNAP = 1e-4  # cells: moves that are this near to whole cells are whole


class HeldPairs(NamedTuple):
    """Controls and disturbances that are held during a step.

    Attributes:
        u: Controls (pairs, m).
        d: Disturbances (pairs, n).
    """

    u: Array
    d: Array


class Room(NamedTuple):
    """Grid around the states at which steps begin.

    Attributes:
        below, above: Distances (k, 1, n) [cells] to the limits at which a step is cut short; infinite for none.
    """

    below: Array
    above: Array


@dataclass(frozen=True, eq=False)
class Motion:
    """Paths of k states under p pairs.

    Attributes:
        durations: Durations (k, p) [s]; 0 where nothing moves, or where the equations give no number.
        moves: Displacements at the end (k, p, n) [cells]; 0 where there is no step.
        first, last: Rates at the beginning and at the end (k, p, n) [cells/s].
    """

    durations: Array
    moves: Array
    first: Array
    last: Array

    def path(self, parts: int) -> Array:
        """Return displacements (k, p, parts, n) [cells] after each part of the duration.

        Cubic Hermite interpolation between the two ends: as accurate as the step, without evaluating the system again.
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
        """Return the lower and upper corner (k, p, n) [cells] of a box around each path, that of its control points."""
        third = self.durations[..., None] / 3.0
        points = third * self.first, self.moves - third * self.last, self.moves
        return reduce(np.minimum, points, np.zeros(1)), reduce(np.maximum, points, np.zeros(1))

    def of(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> Motion:
        """Return the motion of some states under some pairs, one dimension less: (m,) for (k, p)."""
        return Motion(*(each[row, column] for each in (self.durations, self.moves, self.first, self.last)))

    def along(self, axes: tuple[int, ...]) -> Motion:
        """Return the motion along some axes alone."""
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
    """Return the paths of states until they have moved `cells` along the axis on which they are fastest, or to a limit.

    A step also ends where a Runge-Kutta step of fourth order would lose the path, such as on a circle smaller than a
    cell.

    Args:
        system: System that moves.
        x: States at which the steps begin (k, 1, n).
        pairs: Controls and disturbances of the p pairs.
        spacings: Spacing of each axis (n,), in its unit.
        room: Distances to the limits.
        cells: Length of the steps [cells].
        patience: Multiple of the duration of the fastest pair at a state after which the others end as well, unless
            the disturbances could not do much more by then.
        controls: Number of controls, the faster index of the pairs.
    """
    first = _rates(system, x, pairs, spacings)
    fastest = _over_axes(np.maximum, np.abs(first))
    moving = np.isfinite(fastest) & (fastest > 0.0)
    h = np.where(moving, cells / np.where(moving, fastest, 1.0), 0.0)
    longest = np.full((len(x), 1), np.inf)
    if patience is not None:
        # Who knows for how long the other one holds on gains by it: as much as the other could do in that time.
        finite = np.where(moving[..., None], first, 0.0).reshape(len(x), -1, controls, first.shape[-1])
        spread = np.ptp(finite, axis=1).max(axis=(-2, -1))[:, None]
        quickest = np.where(moving, fastest, 0.0).max(axis=1, keepdims=True)
        with np.errstate(divide="ignore"):
            longest = cells * np.maximum(patience / quickest, _ROOM_OF_DISTURBANCE / spread)
        h = np.minimum(h, longest)
    # The rate half way tells the duration well enough to begin with.
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
    """Factor by which a displacement (k, p, n) must grow to reach its plane, or the first limit on the way."""
    # From a limit outwards there is no room at all: the step stays as long, and is refused by where it ends.
    below, above = (np.where(way < 1e-6, cells, np.minimum(way, cells)) for way in room)
    with np.errstate(divide="ignore", invalid="ignore"):
        return _over_axes(np.minimum, np.where(move < 0.0, below, above) / np.abs(move))


def _onto_plane(motion: Motion, room: Room, cells: float) -> Motion:
    """Move ends that are almost on a plane of the grid onto it, where there is an axis less to interpolate along."""
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
    """Correct those steps, in place, that end far from their plane or have lost their path; 0 if none follows it.

    `step` holds durations (k, p) [s], displacements (k, p, n) [cells] and rates at the beginning (k, p, n) [cells/s];
    `which` says which steps to correct, and which of them have lost their path (k, p); `longest` (k, p) is in s.
    """
    h, move, first = step
    row, column = np.nonzero(which[0])
    longest, lost = longest[row, column], which[1][row, column]
    below, above = (np.broadcast_to(each, (len(x), 1, x.shape[-1]))[row, 0] for each in (room.below, room.above))
    for turn in range(_HALVINGS):
        now = h[row, column]
        longest = np.where(lost, 0.5 * now, longest)  # what was not smooth is not prolonged again
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
    """Rates (k, p, n) [cells/s], NaN or infinite where the equations give no number."""
    with np.errstate(all="ignore"):
        rates = system.dynamics(x, *pairs) / spacings
    return np.broadcast_to(rates, (len(x), len(pairs.u), rates.shape[-1]))


def _runge_kutta(
    system: System, x: Array, pairs: HeldPairs, spacings: Array, h: Array, first: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return displacements [cells] by one step of the classical method, and whether each has lost its path.

    The second and third stage agree where the path is smooth over the step: their difference measures that for free.
    """
    dt = h[..., None]
    with np.errstate(all="ignore"):  # a trial step may lead to where the equations give no number
        k2 = system.dynamics(x + (0.5 * dt * spacings) * first, *pairs)
        k3 = system.dynamics(x + 0.5 * dt * k2, *pairs)
        k4 = system.dynamics(x + dt * k3, *pairs)
        bent = _over_axes(np.maximum, np.abs((k3 - k2) / spacings)) * h
        k2 += k3
        move = dt / 6.0 * (first + (2.0 * k2 + k4) / spacings)
        lost = ~(_over_axes(np.logical_and, np.isfinite(move)) & (bent <= _BENT))
    return move, lost & (h > 0.0)


def _over_axes(combine: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
    """Combine values (..., n) over the n axes: for so few, several times as quick as NumPy's own reduction."""
    return np.asarray(reduce(combine, (values[..., k] for k in range(values.shape[-1]))))

"""Time to reach on a grid of (gear, heading, row, column), by sweeps over tiles of the map in the order of their times.

The value of a state is the least, over the arcs that leave it, of the arc's duration and the value at its end, which is
interpolated between four cells. All states of a heading have the same arcs, so a row of a tile is evaluated at once, in
the processor's vectors, which is some hundred times as fast as one state after the other. A row's arc is evaluated
again only if the rows in which it ends have changed since.

The tiles with the earliest changes are swept first, as in Dijkstra's algorithm, so most values are lowered few times. A
tile reads its neighbours alone: tiles of one of four colours never touch, and are shared by the threads without
changing the result.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_navigation.cars.arcs import EASY, Arcs
from ctrl_rl_navigation.cars.tiles import COLUMNS, ROWS, Share, Tiling

FAR = np.float32(1e6)
"""Value of a state that no sweep has reached [s]; that of a state in collision is inf."""
_LEAST_WEIGHT = np.float32(0.3)
"""Sum of the weights of cells without collision at an arc's end, below which the arc does not count."""
_SLOW = np.float32(1.5)
"""Duration of an arc that is free but not easy, as a multiple: cars drive slowly where they hardly fit."""
_BETTER = np.float32(1e-3)
"""Minimum decrease of a value that counts [s]."""
_SWEEPS = 4
"""Sweeps over a tile before others have their turn."""
_FAST = {"nnan", "nsz", "arcp", "contract", "reassoc"}


@njit(inline="always")
def _by_gear(own: Any, other: Any, change: Any, best: Any) -> None:
    """Set the best values of a row: its own, or those of the other gear after a change."""
    for j in range(COLUMNS):
        changed = other[j] + change
        best[j] = changed if changed < own[j] else own[j]


@njit(inline="always")
def _by_arc(flat: Any, at: int, width: int, w: Any, time: Any, ok: Any, arc: int, aside: Any, best: Any) -> None:
    """Lower the best values of a row by an arc whose ends lie between the cells from `at` on, and those one row on."""
    far, zero = np.float32(np.inf), np.float32(0.0)
    # Four views, since indices other than the loop's own keep the compiler from using vectors.
    first, second = flat[at : at + COLUMNS], flat[at + 1 : at + 1 + COLUMNS]
    third, fourth = flat[at + width : at + width + COLUMNS], flat[at + width + 1 : at + width + 1 + COLUMNS]
    wa, wb, wc, wd = w[0], w[1], w[2], w[3]
    bit, easy, slow = np.uint32(1 << arc), np.uint32(1 << (arc + EASY)), _SLOW * time
    for j in range(COLUMNS):
        a, b, c, d = first[j], second[j], third[j], fourth[j]
        x, y = (a if a < b else b), (c if c < d else d)
        most = (x if x < y else y) + aside
        # Cells in collision do not count: the arc itself touches nothing.
        fa, fb = (wa if a < far else zero), (wb if b < far else zero)
        fc, fd = (wc if c < far else zero), (wd if d < far else zero)
        total = fa + fb + fc + fd
        a, b = (a if a < most else most), (b if b < most else most)
        c, d = (c if c < most else most), (d if d < most else most)
        found = (fa * a + fb * b + fc * c + fd * d) / total + (time if (ok[j] & easy) != 0 else slow)
        good = (ok[j] & bit) != 0 and total > _LEAST_WEIGHT and found < best[j]
        best[j] = found if good else best[j]


@njit(inline="always")
def _keep(best: Any, own: Any) -> Any:
    """Store the values that are better, and return the least of these."""
    lowest = np.float32(np.inf)
    for j in range(COLUMNS):
        better = best[j] < own[j] - _BETTER
        value = best[j] if better else np.float32(np.inf)
        lowest = value if value < lowest else lowest
        own[j] = best[j] if better else own[j]
    return lowest


class Sweeps(NamedTuple):
    """What sweeps read and write.

    Attributes:
        values: Values by gear, heading, row and column (2, H, R, C) [s].
        allowed: A bit for each free arc, and one for each easy one (2, H, R, C).
        changed: Sweep in which a row of a tile changed last (2, H, R, 1 + tiles beside each other + 1).
        seen: Sweep in which it was evaluated last, likewise.
        keys: The least value that the sweeps of a tile have changed, inf for none (tiles, tiles) [s].
        unfinished: Whether its last sweep still changed something (tiles, tiles).
        change: Time of a change of gear [s].
        aside: Most by which the values of cells side by side differ [s].
        border: Width of the border around the tiles [cells].
    """

    values: NDArray[np.float32]
    allowed: NDArray[np.uint32]
    changed: NDArray[np.int32]
    seen: NDArray[np.int32]
    keys: NDArray[np.float32]
    unfinished: NDArray[np.bool_]
    change: np.float32
    aside: np.float32
    border: int


def _sweep(to: Any, arcs: Any, tiles: Any, clock: int) -> None:
    """Sweep tiles, given by their row and column among the tiles (n, 2); `clock` is the number of the first sweep."""
    _, headings, height, width = to.values.shape
    flat, bits = to.values.reshape(-1), to.allowed.reshape(-1)
    changed, half, steps = to.changed, headings * height * width, 2 * headings * ROWS
    best = np.empty(COLUMNS, np.float32)
    for number in range(len(tiles)):
        top, beside = to.border + tiles[number, 0] * ROWS, tiles[number, 1] + 1
        left = to.border + tiles[number, 1] * COLUMNS
        key, again = np.float32(np.inf), True
        for turn in range(_SWEEPS):
            if not again:
                break
            now, again = clock + turn, False
            for step in range(steps):
                place = step if turn % 2 == 0 else steps - 1 - step
                gear, heading, row = place // (headings * ROWS), place // ROWS % headings, top + place % ROWS
                last = to.seen[gear, heading, row, beside]
                to.seen[gear, heading, row, beside] = now
                i = ((gear * headings + heading) * height + row) * width + left
                ok, own = bits[i : i + COLUMNS], flat[i : i + COLUMNS]
                started = changed[1 - gear, heading, row, beside] >= last
                if started:
                    other = i + half - 2 * gear * half
                    _by_gear(own, flat[other : other + COLUMNS], to.change, best)
                for arc in range(arcs.times.shape[2]):
                    end, to_row = arcs.ends[gear, heading, arc], row + arcs.rows[gear, heading, arc]
                    shift = arcs.columns[gear, heading, arc]
                    nearby = beside + (1 if shift >= 0 else -1)
                    if (
                        changed[gear, end, to_row, beside] < last
                        and changed[gear, end, to_row + 1, beside] < last
                        and changed[gear, end, to_row, nearby] < last
                        and changed[gear, end, to_row + 1, nearby] < last
                    ):
                        continue
                    if not started:
                        started = True
                        best[:] = own
                    at = ((gear * headings + end) * height + to_row) * width + left + shift
                    weights, time = arcs.weights[gear, heading, arc], arcs.times[gear, heading, arc]
                    _by_arc(flat, at, width, weights, time, ok, arc, to.aside, best)
                if started:
                    lowest = _keep(best, own)
                    if lowest < np.inf:
                        changed[gear, heading, row, beside] = now
                        again, key = True, min(key, lowest)
        to.keys[tiles[number, 0], tiles[number, 1]] = key
        to.unfinished[tiles[number, 0], tiles[number, 1]] = again


sweep = cached_njit(_sweep, nogil=True, fastmath=_FAST, error_model="numpy")


class Spread:
    """Values that spread from a goal.

    Args:
        free: Whether the car touches nothing, by state (H, R, C).
        allowed: A bit for each free arc, and one for each easy one, by state (2, H, R, C).
        arcs: The arcs.
        tiling: Tiles of the rows and columns.
        change: Time of a change of gear [s].
        aside: Most by which the values of cells side by side differ [s].
        window: Time after the earliest change within which tiles are swept together [s].

    Attributes:
        values: Times to reach (2, H, R, C) [s]: FAR where no sweep has been, inf in collision.
        final: Time below which the values are final [s].
    """

    def __init__(
        self,
        free: NDArray[np.bool_],
        allowed: NDArray[np.uint32],
        arcs: Arcs,
        tiling: Tiling,
        change: float,
        aside: float,
        window: float,
    ) -> None:
        self._arcs, self._tiling, self._window = arcs, tiling, window
        self.values = np.empty((2, *free.shape), np.float32)
        self.values[:] = np.where(free, FAR, np.float32(np.inf))
        self.final = 0.0
        stamps, tiles = (2, *free.shape[:2], tiling.columns + 2), (tiling.rows, tiling.columns)
        self._clock, self._to = (
            1,
            Sweeps(
                self.values,
                allowed,
                np.full(stamps, -1, np.int32),
                np.zeros(stamps, np.int32),
                np.empty(tiles, np.float32),
                np.empty(tiles, np.bool_),
                np.float32(change),
                np.float32(aside),
                tiling.border,
            ),
        )
        self._due = np.full(tiles, np.inf, np.float32)
        self._open, self._begun = tiling.any(free), np.zeros(tiles, np.bool_)
        rows, columns = np.indices(tiles) % 2
        self._colours = [(rows == row) & (columns == column) for row in range(2) for column in range(2)]

    @property
    def reached(self) -> float:
        """Fraction of the tiles with free states of which a state has a time."""
        return float(self._begun.sum()) / max(int(self._open.sum()), 1)

    def seed(self, states: NDArray[np.int64]) -> None:
        """Set states (n, 3), given by heading, row and column, to zero in both gears."""
        headings, rows, columns = states.T
        up, beside = (rows - self._tiling.border) // ROWS, (columns - self._tiling.border) // COLUMNS
        self.values[:, headings, rows, columns] = 0.0
        self._to.changed[:, headings, rows, beside + 1] = self._clock
        self._due[up, beside] = 0.0
        self._due = _around(self._due)

    def advance(self, share: Share) -> bool:
        """Sweep the tiles with the earliest changes; return whether some are left."""
        self.final = float(self._due[self._open].min(initial=np.inf))
        if self.final == np.inf:
            return False
        for colour in self._colours:
            mine = self._open & colour & (self._due <= self.final + self._window)
            if mine.any():
                self._sweep(mine, share)
        return True

    def _sweep(self, tiles: NDArray[np.bool_], share: Share) -> None:
        """Sweep marked tiles, none of which touch each other; then those around have their turn if these changed."""
        self._to.keys[:] = self._due[tiles] = np.inf
        self._to.unfinished[:] = False
        self._begun |= tiles
        share(lambda part: sweep(self._to, self._arcs, part, self._clock), np.argwhere(tiles))
        finished = tiles & ~self._to.unfinished
        self._due = np.minimum(self._due, np.where(finished, np.inf, _around(self._to.keys)))
        self._clock += _SWEEPS


def _around(keys: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the least of each tile's key and those of the eight around it (tiles, tiles)."""
    from scipy.ndimage import minimum_filter  # slow import

    least: NDArray[np.float32] = minimum_filter(keys, 3, mode="constant", cval=np.inf)
    return least

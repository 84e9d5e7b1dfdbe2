"""Arcs of a car on a grid of (heading, row, column): where each lands, how long it takes, and what it sweeps.

A turn changes the heading by whole steps of the grid, so only the position is interpolated, between four cells. All
cells are alike, so an arc is one row of a table for each heading. A straight arc has the length, within bounds, whose
end is closest to a cell, where the interpolation error per length is smallest.

An arc is free if the room around the car's rectangle is at least the margin all along, and easy if it is half a cell
more: a car between two states may have that much less room than they have. The room is interpolated at poses about a
cell apart, between the eight states around each.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_navigation.cars.tiles import COLUMNS, ROWS

Array = NDArray[np.float64]

_SHORT, _LONG = (1.0, 1.8), (3.0, 6.0)
"""Minimum and maximum length of short and long straight arcs [cells]."""
_TURNS = (1.0, 2.2, 3.3, 4.4)
"""Minimum lengths of turns [cells]. Of several, one ends close to a cell: with the first two alone, times in the open
are 2.6 % too long, with all of them 1.6 % (median, for a turning radius of 12.5 cells)."""
EASY = 16
"""Place of the first bit of the easy arcs."""
_APART = 1.2
"""Maximum distance between poses of an arc at which the room is interpolated [cells]."""


class Arcs(NamedTuple):
    """Arcs by gear (0 forward, 1 reverse), heading at their start, and number (G, H, A).

    Attributes:
        ends: Heading at the end (G, H, A).
        rows: Rows from the start to the first of the four cells at the end (G, H, A).
        columns: Columns from the start to it (G, H, A).
        weights: Weights of these cells: two of a row, then two of the next one (G, H, A, 4).
        times: Duration (G, H, A) [s].
        counts: Number of poses at which the room is interpolated (G, H, A).
        swept: These poses: headings, rows and columns from the start to the first of the eight states (G, H, A, P, 3).
        shares: Their shares of the way to the next heading, row and column (G, H, A, P, 3).
    """

    ends: NDArray[np.int64]
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    weights: NDArray[np.float32]
    times: NDArray[np.float32]
    counts: NDArray[np.int64]
    swept: NDArray[np.int64]
    shares: NDArray[np.float32]


def turns_of(radius: float, headings: int) -> list[int]:
    """Return by how many headings turns of a radius [cells] change, to the left and to the right."""
    step = 2.0 * math.pi / headings * radius
    steps = sorted({max(1, math.ceil(least / step - 1e-9)) for least in _TURNS})
    return [sign * each for each in steps for sign in (1, -1)]


def longest_of(radius: float, headings: int) -> float:
    """Return the length of the longest arc [cells]."""
    return max(max(turns_of(radius, headings)) * 2.0 * math.pi / headings * radius, _LONG[1])


def make_arcs(radius: float, headings: int, speeds: tuple[float, float], cell: float) -> Arcs:
    """Tabulate arcs.

    Args:
        radius: Radius of the tightest turn [cells].
        headings: Number of headings.
        speeds: Forward and reverse speed [m/s].
        cell: Length of a cell [m].
    """
    turns, step = [*turns_of(radius, headings), 0, 0], 2.0 * math.pi / headings
    size = (2, headings, len(turns))
    most = math.ceil(longest_of(radius, headings) / _APART) + 1
    out = Arcs(
        np.zeros(size, np.int64),
        np.zeros(size, np.int64),
        np.zeros(size, np.int64),
        np.zeros((*size, 4), np.float32),
        np.zeros(size, np.float32),
        np.zeros(size, np.int64),
        np.zeros((*size, most, 3), np.int64),
        np.zeros((*size, most, 3), np.float32),
    )
    for gear, sign in enumerate((1.0, -1.0)):
        for start in range(headings):
            for number, turn in enumerate(turns):
                at, curvature = (gear, start, number), 0.0
                if turn:
                    length, curvature = abs(turn) * step * radius, math.copysign(1.0 / radius, sign * turn)
                else:
                    length = _straight(start * step, _SHORT if number == len(turns) - 2 else _LONG)
                parts = math.ceil(length / _APART)
                shares = np.arange(1, parts + 1) / parts
                poses = np.array(
                    [(share * turn, *_move(start * step, sign * share * length, curvature)) for share in shares]
                )
                first = np.floor(poses + 1e-9)
                rest = np.maximum(poses - first, 0.0)
                out.counts[at], out.swept[at][:parts], out.shares[at][:parts] = parts, first, rest
                out.ends[at], (out.rows[at], out.columns[at]) = (start + turn) % headings, first[-1, 1:]
                u, v = rest[-1, 1:].tolist()
                out.weights[at] = ((1.0 - u) * (1.0 - v), (1.0 - u) * v, u * (1.0 - v), u * v)
                out.times[at] = length * cell / speeds[gear]
    return out


def _move(theta: float, way: float, curvature: float) -> tuple[float, float]:
    """Return the change of y and x on an arc of a length, negative in reverse."""
    half = 0.5 * way * curvature
    chord = way if abs(half) < 1e-9 else way * math.sin(half) / half
    return chord * math.sin(theta + half), chord * math.cos(theta + half)


def _straight(theta: float, bounds: tuple[float, float]) -> float:
    """Return the length within bounds that has the smallest interpolation error per length."""
    lengths = np.linspace(*bounds, 161)
    rest = np.stack((lengths * math.cos(theta), lengths * math.sin(theta))) % 1.0
    return float(lengths[np.argmin((rest * (1.0 - rest)).sum(axis=0) / lengths)])


@njit(inline="always")
def _interpolate(flat: Any, at: int, width: int, u: Any, v: Any, share: Any, fresh: bool, out: Any) -> None:
    """Set a row of numbers to a share of what is interpolated between two rows of a heading, or add that."""
    a, b = flat[at : at + COLUMNS], flat[at + 1 : at + 1 + COLUMNS]
    c, d = flat[at + width : at + width + COLUMNS], flat[at + width + 1 : at + width + 1 + COLUMNS]
    one = np.float32(1.0)
    wa, wb, wc, wd = share * (one - u) * (one - v), share * (one - u) * v, share * u * (one - v), share * u * v
    if fresh:
        for j in range(COLUMNS):
            out[j] = wa * a[j] + wb * b[j] + wc * c[j] + wd * d[j]
    else:
        for j in range(COLUMNS):
            out[j] += wa * a[j] + wb * b[j] + wc * c[j] + wd * d[j]


def _allow_arcs(room: Any, arcs: Any, margin: Any, easy: Any, reach: Any, tiles: Any, out: Any) -> None:
    """Mark which arcs from the states of tiles are free, and which are easy.

    Args:
        room: Room around the car (H, R, C) [m].
        arcs: The arcs.
        margin: Room of a free arc [m].
        easy: Room of an easy one [m].
        reach: Most by which the room changes on an arc [m].
        tiles: First row and column of each tile (n, 2).
        out: A bit for each free arc, and from bit `EASY` on one for each easy one (2, H, R, C).
    """
    headings, height, width = room.shape
    flat = room.reshape(-1)
    least, here = np.empty(COLUMNS, np.float32), np.empty(COLUMNS, np.float32)
    bits = np.empty(COLUMNS, np.uint32)
    count = arcs.times.shape[2]
    one, few = np.float32(1.0), np.float32(1e-4)
    for number in range(len(tiles)):
        top, left = tiles[number]
        for heading in range(headings):
            for row in range(top, top + ROWS):
                i = (heading * height + row) * width + left
                own = flat[i : i + COLUMNS]
                widest, tightest = own.max(), own.min()
                for gear in range(2):
                    bits[:] = np.uint32(((1 << EASY) + 1) * ((1 << count) - 1) if tightest >= easy + reach else 0)
                    for arc in range(count if tightest < easy + reach and widest >= margin else 0):
                        least[:] = own
                        for pose in range(arcs.counts[gear, heading, arc]):
                            turned, rows, columns = arcs.swept[gear, heading, arc, pose]
                            p, u, v = arcs.shares[gear, heading, arc, pose]
                            shift = (row + rows) * width + left + columns
                            low = (heading + turned) % headings * height * width + shift
                            _interpolate(flat, low, width, u, v, one - p, True, here)
                            if p > few:
                                high = (heading + turned + 1) % headings * height * width + shift
                                _interpolate(flat, high, width, u, v, p, False, here)
                            for j in range(COLUMNS):
                                least[j] = here[j] if here[j] < least[j] else least[j]
                        bit, both = np.uint32(1 << arc), np.uint32(((1 << EASY) + 1) << arc)
                        for j in range(COLUMNS):
                            bits[j] |= both if least[j] >= easy else bit if least[j] >= margin else np.uint32(0)
                    out[gear, heading, row, left : left + COLUMNS] = bits


allow_arcs = cached_njit(_allow_arcs, nogil=True, fastmath={"nnan", "nsz", "contract"})

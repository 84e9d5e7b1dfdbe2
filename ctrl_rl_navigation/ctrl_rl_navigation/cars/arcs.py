"""Arcs of a car on a grid of (heading, row, column): where each lands, how long it takes, and what it passes.

A turn changes the heading by whole steps of the grid, so only the position is interpolated, between four cells. All
cells are alike, so an arc is one row of a table for each heading. A straight arc has the length, within bounds, whose
end is closest to a cell, where the interpolation error per length is smallest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SHORT, _LONG = (1.0, 1.8), (3.0, 6.0)
"""Minimum and maximum length of short and long straight arcs [cells]."""
_TURNS = (1.0, 2.2, 3.3, 4.4)
"""Minimum lengths of turns [cells]. Of several, one ends close to a cell: with the first two alone, times in the open
are 2.6 % too long, with all of them 1.6 % (median, for a turning radius of 12.5 cells)."""


class Arcs(NamedTuple):
    """Arcs by gear (0 forward, 1 reverse), heading at their end, and number (G, H, A).

    Attributes:
        offsets: From the first of the four cells at the end to the start, as a flat index (G, H, A).
        weights: Weights of the four cells at the end: two of a row, then two of the next one (G, H, A, 4).
        times: Duration (G, H, A) [s].
        passed: From the start to the cells that the arc passes, as flat indices (G, H, A, M); 0 for no more.
    """

    offsets: NDArray[np.int64]
    weights: NDArray[np.float32]
    times: NDArray[np.float32]
    passed: NDArray[np.int64]


def turns_of(radius: float, headings: int) -> list[int]:
    """Return by how many headings turns of a radius [cells] change, to the left and to the right."""
    step = 2.0 * math.pi / headings * radius
    steps = sorted({max(1, math.ceil(least / step - 1e-9)) for least in _TURNS})
    return [sign * each for each in steps for sign in (1, -1)]


def border_of(radius: float, headings: int) -> int:
    """Return the width of a border around the grid that no arc crosses [cells]."""
    longest = max(abs(turn) for turn in turns_of(radius, headings)) * 2.0 * math.pi / headings * radius
    return math.ceil(max(longest, _LONG[1])) + 2


def make_arcs(radius: float, headings: int, speeds: tuple[float, float], cell: float, shape: tuple[int, int]) -> Arcs:
    """Tabulate arcs.

    Args:
        radius: Radius of the tightest turn [cells].
        headings: Number of headings.
        speeds: Forward and reverse speed [m/s].
        cell: Length of a cell [m].
        shape: Number of rows and columns of the grid with its border.
    """
    turns, step, (height, width) = [*turns_of(radius, headings), 0, 0], 2.0 * math.pi / headings, shape
    size = (2, headings, len(turns))
    most = border_of(radius, headings)
    out = Arcs(
        np.zeros(size, np.int64),
        np.zeros((*size, 4), np.float32),
        np.zeros(size, np.float32),
        np.zeros((*size, most), np.int64),
    )
    for gear, sign in enumerate((1.0, -1.0)):
        for end in range(headings):
            for number, turn in enumerate(turns):
                start, at = (end - turn) % headings, (gear, end, number)
                if turn:
                    length, curvature = abs(turn) * step * radius, math.copysign(1.0 / radius, sign * turn)
                else:
                    bounds = _SHORT if number == len(turns) - 2 else _LONG
                    length, curvature = _straight(start * step, bounds), 0.0
                x, y = _move(start * step, sign * length, curvature)
                row, column = math.floor(y + 1e-9), math.floor(x + 1e-9)
                u, v = max(y - row, 0.0), max(x - column, 0.0)
                out.offsets[at] = (start - end) * height * width - row * width - column
                out.weights[at] = ((1.0 - u) * (1.0 - v), (1.0 - u) * v, u * (1.0 - v), u * v)
                out.times[at] = length * cell / speeds[gear]
                places = []
                for share in np.arange(1, math.ceil(length)) / math.ceil(length):
                    x, y = _move(start * step, sign * share * length, curvature)
                    turned = (start + round(share * turn)) % headings - start
                    places.append(turned * height * width + round(y) * width + round(x))
                passed = [place for place in places if place]
                out.passed[at][: len(passed)] = passed
    return out


def _move(theta: float, way: float, curvature: float) -> tuple[float, float]:
    """Return the change of x and y on an arc of a length, negative in reverse."""
    half = 0.5 * way * curvature
    chord = way if abs(half) < 1e-9 else way * math.sin(half) / half
    return chord * math.cos(theta + half), chord * math.sin(theta + half)


def _straight(theta: float, bounds: tuple[float, float]) -> float:
    """Return the length within bounds that has the smallest interpolation error per length."""
    lengths = np.linspace(*bounds, 161)
    rest = np.stack((lengths * math.cos(theta), lengths * math.sin(theta))) % 1.0
    return float(lengths[np.argmin((rest * (1.0 - rest)).sum(axis=0) / lengths)])

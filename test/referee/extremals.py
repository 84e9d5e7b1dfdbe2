"""Times to a box in the plane for x' = v, v' = g(x, v) + b u, by Pontryagin's extremals run back from the box.

From each point of the box's boundary at which some control leads in, the extremal that ends there is followed back in
time: the costate begins as the outward normal there, at a corner as each one between its two normals, and says which
bound u has. Each is a path that can be driven, and the fastest path is among them. Between neighbouring ones times are
interpolated over triangles, onto nodes finer than the solver's; the least time wins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numba import njit

from ctrl_rl_core import Axis, Interval
from referee.case import Array, Reference

FIRST, ROUNDS, MOST = 40, 8, 600
"""Extremals from each face and corner to begin with; rounds in which more go between those that part; most of them."""
APART = 0.03
"""How far neighbours may part, relative to the grid."""
STEPS = 1500
FINER = 4
EDGE = 2
"""Cells at the grid's edges where a solver's steps end outside: what passes there is not judged."""
WIDER = 0.5
"""How far beyond the grid paths are followed, relative to it: where a faster one goes there, the edges bind."""
WIDEST = 0.2
"""Neighbouring extremals this far apart, relative to the grid, say nothing about what lies between them."""

Field = Callable[[Array, Array], tuple[Array, Array, Array]]
"""Returns g, dg/dx and dg/dv (N,) at x (N,) and v (N,)."""


End = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Plane:
    """The system x' = v, v' = g(x, v) + [low, high] and its box."""

    field: Field
    low: float
    high: float
    box: tuple[Interval, Interval]
    axes: Sequence[Axis]

    def reference(self, horizon: float) -> Reference:
        """Return the times to reach; NaN where no path comes by, or the fastest runs along the grid's edge."""
        counts = [a.count * FINER if a.periodic else (a.count - 1) * FINER + 1 for a in self.axes]
        spacing = np.array([a.spacing for a in self.axes]) / FINER
        lower = np.array([a.lower for a in self.axes])
        rounds = np.array([a.periodic for a in self.axes])
        gap = np.full((1, STEPS + 1, 2), np.nan)
        parts = [part for fan in self._fans(horizon) for part in (fan, gap)]
        paths = (np.concatenate(parts) - lower) / spacing
        table, inner = np.full(counts, np.inf), np.full(counts, np.inf)
        _spread(paths, horizon / STEPS, table, rounds, WIDEST * np.array(counts))
        edges = EDGE * FINER
        for k, count in enumerate(counts):
            if not rounds[k]:
                out = (paths[..., k] < edges) | (paths[..., k] > count - 1 - edges)
                paths[np.logical_or.accumulate(out, axis=1)] = np.nan
        _spread(paths, horizon / STEPS, inner, rounds, WIDEST * np.array(counts))
        inner[inner > 1.001 * table] = np.inf

        def times(states: Array) -> Array:
            return _look_up(inner, (states - lower) / spacing, rounds)

        return times

    def _ends(self) -> list[End]:
        """Return faces and corners: the states (N, 2) and outward normals (N, 2) that numbers (N,) 0..1 stand for."""
        lows, highs = np.array(self.box).T
        faces = [partial(_face, lows, highs, axis, side) for axis in range(2) for side in (-1.0, 1.0)]
        return faces + [partial(_corner, lows, highs, np.array([x, v])) for x in (-1.0, 1.0) for v in (-1.0, 1.0)]

    def _fans(self, horizon: float) -> list[Array]:
        """Return the paths (N, STEPS + 1, 2) from each face and corner, with more of them where neighbours part."""
        scale = np.array([axis.upper - axis.lower for axis in self.axes])
        ends = self._ends()
        numbers, fans = [np.empty(0)] * len(ends), [np.empty((0, STEPS + 1, 2))] * len(ends)
        new = [np.linspace(0.0, 1.0, FIRST)] * len(ends)
        for _ in range(ROUNDS):
            states, normals = zip(*(end(at) for end, at in zip(ends, new, strict=True)), strict=True)
            paths = self._back(np.concatenate(states), np.concatenate(normals), horizon)
            for k, each in enumerate(np.split(paths, np.cumsum([len(at) for at in new])[:-1])):
                order = np.argsort(np.concatenate((numbers[k], new[k])))
                numbers[k] = np.concatenate((numbers[k], new[k]))[order]
                fans[k] = np.concatenate((fans[k], each))[order]
                new[k] = _between(numbers[k], fans[k] / scale)
            if not any(len(at) for at in new):
                break
        return fans

    def _back(self, state: Array, costate: Array, horizon: float) -> Array:
        """Return the paths (N, STEPS + 1, 2) back in time, NaN from where they are far outside the grid."""
        dt = horizon / STEPS
        x, v, p, q = *state.T.copy(), *costate.T.copy()
        g = self.field(x, v)[0]
        leads_in = p * v + q * g + np.minimum(q * self.low, q * self.high) < 0.0
        x[~leads_in] = np.nan
        paths = np.empty((len(x), STEPS + 1, 2))
        paths[:, 0] = np.stack((x, v), axis=1)
        for step in range(1, STEPS + 1):
            # The costate half a step on tells the control of the step: at a face q is 0 and about to grow.
            u = np.where(q + 0.5 * dt * self._rates(x, v, p, q, q)[3] > 0.0, self.low, self.high)
            k1 = self._rates(x, v, p, q, u)
            k2 = self._rates(*(y + 0.5 * dt * k for y, k in zip((x, v, p, q), k1, strict=True)), u)
            x, v, p, q = (y + dt * k for y, k in zip((x, v, p, q), k2, strict=True))
            gone = np.zeros(len(x), dtype=bool)
            for axis, values in zip(self.axes, (x, v), strict=True):
                if not axis.periodic:
                    wider = WIDER * (axis.upper - axis.lower)
                    gone |= (values < axis.lower - wider) | (values > axis.upper + wider)
            x = np.where(gone, np.nan, x)
            size = np.maximum(np.abs(p), np.abs(q))
            p, q = p / size, q / size
            paths[:, step] = np.stack((x, v), axis=1)
        return paths

    def _rates(self, x: Array, v: Array, p: Array, q: Array, u: Array) -> tuple[Array, Array, Array, Array]:
        """Return derivatives of state and costate by the time left."""
        g, by_x, by_v = self.field(x, v)
        return -v, -(g + u), q * by_x, p + q * by_v


def _between(numbers: Array, paths: Array) -> Array:
    """Return numbers of paths to add: three between two neighbours that part."""
    apart = np.abs(np.diff(paths, axis=0))
    parted = np.where(np.isfinite(apart), apart, 0.0).max(axis=(1, 2)) > APART
    if len(numbers) + 3 * parted.sum() > MOST:
        return np.empty(0)
    steps = np.diff(numbers)[parted]
    return np.concatenate([numbers[:-1][parted] + share * steps for share in (0.25, 0.5, 0.75)])


def _face(lows: Array, highs: Array, axis: int, side: float, at: Array) -> tuple[Array, Array]:
    states = lows + at[:, None] * (highs - lows)
    states[:, axis] = highs[axis] if side > 0.0 else lows[axis]
    normals = np.zeros(states.shape)
    normals[:, axis] = side
    return states, normals


def _corner(lows: Array, highs: Array, sides: Array, at: Array) -> tuple[Array, Array]:
    states = np.tile(np.where(sides > 0.0, highs, lows), (len(at), 1))
    angles = 0.5 * np.pi * at
    return states, sides * np.stack((np.cos(angles), np.sin(angles)), axis=1) / (highs - lows)


@njit
def _spread(paths: Array, dt: float, table: Array, rounds: Array, widest: Array) -> None:  # pragma: no cover
    corner, when = np.empty((3, 2)), np.empty(3)
    for i in range(paths.shape[0] - 1):
        for j in range(paths.shape[1] - 1):
            for half in range(2):
                for c in range(3):
                    n = c + half  # of (i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1) the first or the last three
                    corner[c] = paths[i + n % 2, j + n // 2]
                    when[c] = dt * (j + n // 2)
                _triangle(corner, when, table, rounds, widest)


@njit
def _triangle(corner: Array, when: Array, table: Array, rounds: Array, widest: Array) -> None:  # pragma: no cover
    low, high = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    for k in range(2):
        least, most = min(corner[0, k], corner[1, k], corner[2, k]), max(corner[0, k], corner[1, k], corner[2, k])
        if not most - least <= widest[k]:  # NaN too
            return
        low[k], high[k] = int(np.ceil(least)), int(np.floor(most))
        if not rounds[k]:
            low[k], high[k] = max(low[k], 0), min(high[k], table.shape[k] - 1)
    ax, ay = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1]
    bx, by = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1]
    area = ax * by - ay * bx
    if abs(area) < 1e-12:
        return
    for i in range(low[0], high[0] + 1):
        for j in range(low[1], high[1] + 1):
            x, y = i - corner[0, 0], j - corner[0, 1]
            s, t = (x * by - y * bx) / area, (ax * y - ay * x) / area
            if s >= -1e-9 and t >= -1e-9 and s + t <= 1.0 + 1e-9:
                time = when[0] + s * (when[1] - when[0]) + t * (when[2] - when[0])
                at = i % table.shape[0], j % table.shape[1]
                table[at] = min(table[at], time)


def _look_up(table: Array, places: Array, rounds: Array) -> Array:
    """Return the values at places (N, 2) between the nodes, linear; NaN next to a node without one."""
    found = np.zeros(len(places))
    cells = np.floor(places).astype(int)
    for k in range(2):
        if not rounds[k]:
            cells[:, k] = np.clip(cells[:, k], 0, table.shape[k] - 2)
    share = places - cells
    for i in range(2):
        for j in range(2):
            weight = (share[:, 0] if i else 1.0 - share[:, 0]) * (share[:, 1] if j else 1.0 - share[:, 1])
            at = (cells[:, 0] + i) % table.shape[0], (cells[:, 1] + j) % table.shape[1]
            found += np.where(weight > 1e-12, weight * table[at], 0.0)
    return np.where(np.isfinite(found), found, np.nan)

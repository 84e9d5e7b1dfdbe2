"""Times to a box in the plane for x' = v, v' = g(x, v) + b u, by Pontryagin's extremals run back from the box.

From each point of the box's boundary at which some control leads in, the extremal that ends there is followed back in
time: the costate begins as the outward normal there, at a corner as each one between its two normals, and says which
bound u has. Each is a path that can be driven, and the fastest path is among them. Between neighbouring ones times are
interpolated over triangles, onto nodes finer than the solver's; the least time wins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from ctrl_rl_core import Axis, Interval
from referee.case import Array, Reference

FACE, FAN = 120, 160
"""Number of extremals from a face and from a corner."""
STEPS = 2000
FINER = 4
EDGE = 2
"""Cells at the grid's edges where a solver's steps end outside: what passes there is not judged."""
WIDEST = 0.2
"""Neighbouring extremals this far apart, relative to the grid, say nothing about what lies between them."""

Field = Callable[[Array, Array], tuple[Array, Array, Array]]
"""Returns g, dg/dx and dg/dv (N,) at x (N,) and v (N,)."""


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
        paths = (self._back(*self._ends(), horizon) - lower) / spacing
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

    def _ends(self) -> tuple[Array, Array]:
        """Return states (N, 2) on all faces and corners with their outward normals (N, 2), NaN between two of them."""
        (left, right), (slow, fast) = self.box
        x, v = np.linspace(left, right, FACE), np.linspace(slow, fast, FACE)
        zero, one = np.zeros(FACE), np.ones(FACE)
        size = np.array([right - left, fast - slow])
        ends = [
            (np.stack((x, one * fast), axis=1), np.stack((zero, one), axis=1)),
            (np.stack((x, one * slow), axis=1), np.stack((zero, -one), axis=1)),
            (np.stack((one * right, v), axis=1), np.stack((one, zero), axis=1)),
            (np.stack((one * left, v), axis=1), np.stack((-one, zero), axis=1)),
        ]
        angles = np.linspace(0.0, 0.5 * np.pi, FAN)
        for sx, at_x in ((-1.0, left), (1.0, right)):
            for sv, at_v in ((-1.0, slow), (1.0, fast)):
                normal = np.stack((sx * np.cos(angles), sv * np.sin(angles)), axis=1) / size
                ends.append((np.tile([at_x, at_v], (FAN, 1)), normal))
        gap = np.full((1, 2), np.nan)
        states = [part for state, _ in ends for part in (state, gap)]
        normals = [part for _, normal in ends for part in (normal, gap)]
        return np.concatenate(states), np.concatenate(normals)

    def _back(self, state: Array, costate: Array, horizon: float) -> Array:
        """Return the paths (N, STEPS + 1, 2) back in time, NaN from where they leave the grid."""
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
                    gone |= (values < axis.lower) | (values > axis.upper)
            x = np.where(gone, np.nan, x)
            size = np.maximum(np.abs(p), np.abs(q))
            p, q = p / size, q / size
            paths[:, step] = np.stack((x, v), axis=1)
        return paths

    def _rates(self, x: Array, v: Array, p: Array, q: Array, u: Array) -> tuple[Array, Array, Array, Array]:
        """Return derivatives of state and costate by the time left."""
        g, by_x, by_v = self.field(x, v)
        return -v, -(g + u), q * by_x, p + q * by_v


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

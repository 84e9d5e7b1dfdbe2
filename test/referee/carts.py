"""Carts: x' = k (v - v0), v' = g u + w + d, to a box, within bounds of x and v; a closed form.

With a costate normal to the box where a path ends, Pontryagin's principle leaves few paths: one bang that meets a face;
two bangs, or two with a cruise at a bound of v between them, that end in a corner; one bang and a cruise that meets a
face. All of them are tried, so that the least time is exact. A disturbance of v' takes from either bang what it has.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ctrl_rl_core import Interval, Quantity
from referee.case import (
    Array,
    Case,
    box_target,
    draw_bounds,
    draw_interval,
    draw_scale,
    make_axis,
    make_system,
    numbers,
)
from ttr_reward_node import TimeToReachProblem

TINY = 1e-9
COUNTS = (81, 162)
EDGE = 2


@dataclass(frozen=True)
class Cart:
    """The double integrator y' = v, v' = a.

    Attributes:
        brake: Least a, below 0.
        push: Largest a, above 0.
        y: Bounds of y; what leaves them has failed.
        v: Bounds of v, likewise.
        goal_y: Target in y, within its bounds.
        goal_v: Target in v, within its bounds.
        edge: Width of what lies within the bounds of y, but where a grid's steps end outside: not known there.
    """

    brake: float
    push: float
    y: Interval
    v: Interval
    goal_y: Interval
    goal_v: Interval
    edge: float = 0.0

    def times(self, y: Array, v: Array) -> Array:
        """Return times (N,) to the target; +inf where never, NaN where the fastest path leaves the bounds of y."""
        best, inside = np.full(y.shape, np.inf), np.zeros(y.shape, dtype=bool)
        for time, low, high in self._paths(y, v):
            slack = TINY * self.y.length - self.edge
            within = (low >= self.y.low - slack) & (high <= self.y.high + slack)
            faster = time < best
            inside = np.where(faster, within, inside)
            best = np.where(faster, time, best)
        known = np.where(inside, best, np.nan)
        known = np.where(self._lost(y, v), np.inf, known)
        return np.where((v < self.v.low) | (v > self.v.high), np.nan, known)

    def _paths(self, y: Array, v: Array) -> Iterator[tuple[Array, Array, Array]]:
        """Yield time, least y and largest y (N,) of each path that may be the fastest; an infinite time where none."""
        for a, b, bound in ((self.push, self.brake, self.v.high), (self.brake, self.push, self.v.low)):
            yield self._one_bang(y, v, a)
            yield self._bang_and_cruise(y, v, a, bound)
            for goal_y in self.goal_y:
                for goal_v in self.goal_v:
                    yield from self._to_corner(y, v, a, b, bound, goal_y, goal_v)

    def _one_bang(self, y: Array, v: Array, a: float) -> tuple[Array, Array, Array]:
        times = [np.zeros_like(y), *((goal - v) / a for goal in self.goal_v)]
        for goal in self.goal_y:
            with np.errstate(invalid="ignore"):
                root = np.sqrt(v * v + 2.0 * a * (goal - y))
            times += [(-v - root) / a, (-v + root) / a]
        best = np.full(y.shape, np.inf)
        for t in times:
            end_y, end_v = y + v * t + 0.5 * a * t * t, v + a * t
            hit = (t >= 0.0) & _in(end_y, self.goal_y, self.y.length) & _in(end_v, self.goal_v, self.v.length)
            best = np.where(hit & (t < best), t, best)
        return (best, *_extent(y, v, a, best))

    def _bang_and_cruise(self, y: Array, v: Array, a: float, bound: float) -> tuple[Array, Array, Array]:
        never = np.full(y.shape, np.inf)
        if bound == 0.0 or not self.goal_v.low <= bound <= self.goal_v.high:
            return never, y, y
        first = (bound - v) / a
        at = y + (bound * bound - v * v) / (2.0 * a)
        face = self.goal_y.low if bound > 0.0 else self.goal_y.high
        cruise = (face - at) / bound
        time = np.where(cruise >= 0.0, first + cruise, np.inf)
        low, high = _extent(y, v, a, first)
        return time, np.minimum(low, face), np.maximum(high, face)

    def _to_corner(
        self, y: Array, v: Array, a: float, b: float, bound: float, goal_y: float, goal_v: float
    ) -> Iterator[tuple[Array, Array, Array]]:
        square = (goal_y - y + v * v / (2.0 * a) - goal_v * goal_v / (2.0 * b)) / (0.5 / a - 0.5 / b)
        with np.errstate(invalid="ignore"):
            root = np.sqrt(square)
        for top in (root, -root):
            first, second = (top - v) / a, (goal_v - top) / b
            fits = (first >= 0.0) & (second >= 0.0) & _in(top, self.v, self.v.length)
            switch = y + (top * top - v * v) / (2.0 * a)
            yield self._both(fits, first + second, _extent(y, v, a, first), _extent(switch, top, b, second))
        if bound == 0.0:
            return
        first, second = (bound - v) / a, (goal_v - bound) / b
        at = y + (bound * bound - v * v) / (2.0 * a)
        leave = np.full(y.shape, goal_y - (goal_v * goal_v - bound * bound) / (2.0 * b))
        cruise = (leave - at) / bound
        end = _extent(leave, np.full(y.shape, bound), b, np.full(y.shape, second))
        yield self._both(cruise >= 0.0, first + cruise + second, _extent(y, v, a, first), end)

    @staticmethod
    def _both(
        fits: Array, time: Array, one: tuple[Array, Array], other: tuple[Array, Array]
    ) -> tuple[Array, Array, Array]:
        return np.where(fits, time, np.inf), np.minimum(one[0], other[0]), np.maximum(one[1], other[1])

    def _lost(self, y: Array, v: Array) -> Array:
        """Return from where no braking keeps y within its bounds, and the target is not met on the way out."""
        up = (v > 0.0) & (y - v * v / (2.0 * self.brake) > self.y.high)
        down = (v < 0.0) & (y - v * v / (2.0 * self.push) < self.y.low)
        return np.where(up, ~self._met(y, v, 1.0), np.where(down, ~self._met(y, v, -1.0), False))

    def _met(self, y: Array, v: Array, way: float) -> Array:
        """Return whether the target can be met while v keeps its sign, `way`."""
        last, slow, fast = (
            (self.goal_y.high, self.brake, self.push) if way > 0 else (self.goal_y.low, self.push, self.brake)
        )
        ahead = way * (last - y)
        least = np.sqrt(np.maximum(v * v + 2.0 * slow * (last - y), 0.0))
        most = np.sqrt(np.maximum(v * v + 2.0 * fast * (last - y), 0.0))
        slowest, fastest = (self.goal_v.low, self.goal_v.high) if way > 0 else (-self.goal_v.high, -self.goal_v.low)
        return (ahead >= 0.0) & (least <= fastest) & (most >= slowest)


def _in(values: Array, interval: Interval, scale: float) -> Array:
    return (values >= interval.low - TINY * scale) & (values <= interval.high + TINY * scale)


def _extent(y: Array, v: Array, a: float, time: Array) -> tuple[Array, Array]:
    """Return the least and the largest y of a bang."""
    time = np.where(np.isfinite(time) & (time > 0.0), time, 0.0)
    end = y + v * time + 0.5 * a * time * time
    turns = (-v / a > 0.0) & (-v / a < time)
    turn = np.where(turns, y - v * v / (2.0 * a), y)
    return np.minimum(np.minimum(y, end), turn), np.maximum(np.maximum(y, end), turn)


def cart(_math: Any, p: Any) -> Any:
    """Return the equations x' = k (v - v0), v' = g u + w + d."""
    k, v0, g, w = p["k"], p["v0"], p["g"], p["w"]
    return lambda x, u, d: (k * (x[1] - v0), g * u[0] + w + d[1])


def draw_cart(random: np.random.Generator) -> Case:
    """Draw a cart with unequal brakes, units of its own, wind, disturbance and perhaps a bound of its speed."""
    second, metre = draw_scale(random, 1e-2, 1e2), draw_scale(random, 1e-2, 1e2)
    k = float(random.choice([-1.0, 1.0]) * draw_scale(random, 1e-2, 1e2))
    bounds = draw_bounds(random)
    strength = metre / second**2
    g = float(random.choice([-1.0, 1.0]) * strength)
    pushes = sorted((g * bounds[0], g * bounds[1]))
    w = float(random.uniform(-0.9, 0.9) * strength * random.integers(0, 2))
    pushes = [pushes[0] + w, pushes[1] + w]
    weaker = min(-pushes[0], pushes[1])
    gust = float(random.uniform(0.0, 0.7) * weaker * random.integers(0, 2))
    brake, push = pushes[0] + gust, pushes[1] - gust
    weaker = min(-brake, push)
    half = metre * random.uniform(0.5, 2.0)
    fast = float(np.sqrt(2.0 * weaker * half * draw_scale(random, 0.3, 1.5)))
    v0 = float(random.uniform(-0.5, 0.5) * fast * random.integers(0, 2))
    centre = float(random.uniform(-1.0, 1.0) * half)
    limited = bool(random.random() < 0.3)
    limit = fast * random.uniform(0.5, 0.9) if limited else np.inf
    states = (Quantity("x", "m"), Quantity("v", "m/s", v0 - limit, v0 + limit))
    xs = sorted((k * (centre - half), k * (centre + half)))
    axes = (
        make_axis(states[0], *xs, int(random.integers(*COUNTS))),
        make_axis(states[1], v0 - fast, v0 + fast, int(random.integers(*COUNTS))),
    )
    goal_x = draw_interval(random, axes[0])
    goal_v = draw_interval(random, axes[1], reach=0.3)
    within = Interval(v0 - min(limit, fast), v0 + min(limit, fast))
    ys = sorted((goal_x.low / k, goal_x.high / k))
    exact = Cart(
        brake,
        push,
        Interval(centre - half, centre + half),
        Interval(within.low - v0, within.high - v0),
        Interval(*ys),
        Interval(max(goal_v.low, within.low) - v0, min(goal_v.high, within.high) - v0),
        EDGE * axes[0].spacing / abs(k),
    )
    system = make_system(
        "cart", states, [bounds], cart, {"k": k, "v0": v0, "g": g, "w": w}, [(0.0, 0.0), (-gust, gust)]
    )
    words = numbers(
        k=k,
        v0=v0,
        g=g,
        w=w,
        u=bounds,
        d=gust,
        x=xs,
        v=(v0 - fast, v0 + fast),
        limit=float(limit),
        counts=[axis.count for axis in axes],
        target=(goal_x, goal_v),
    )
    problem = TimeToReachProblem(system, axes, box_target(("x", "v"), (goal_x, goal_v)))
    return Case(words, problem, lambda x: exact.times(x[:, 0] / k, x[:, 1] - v0))

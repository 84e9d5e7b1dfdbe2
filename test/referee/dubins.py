"""A car that only drives forwards and turns unequally well to either side, to a disc or a box, heading free.

Its fastest paths are a turn and a straight, or a turn and one the other way (Dubins 1957; with the heading free on
arrival, Bui et al. 1994). Both are tried for every first turn on a fine lattice, and the first time in the target is
looked for along the second piece.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from ctrl_rl_core import Disc, Quantity, Region
from referee.case import Array, Case, box_target, draw_interval, draw_scale, make_axis, make_system, numbers
from ttr_reward_node import TimeToReachProblem

COUNTS, HEADINGS = (41, 62), (40, 61)
TURNS = 121
"""First turns that are tried, evenly over the circle."""
EDGE = 2


def car(m: Any, p: Any) -> Any:
    """Return the equations of a car at a constant speed that turns at the rate u."""
    speed = p["speed"]
    return lambda x, u, _d: (speed * m.cos(x[2]), speed * m.sin(x[2]), u[0])


@njit
def _inside(x: float, y: float, target: Array) -> bool:  # pragma: no cover
    """Return whether a point lies in a target: a disc (cx, cy, r), or a box (left, right, low, high)."""
    if len(target) == 3:
        return (x - target[0]) ** 2 + (y - target[1]) ** 2 <= target[2] ** 2
    return target[0] <= x <= target[1] and target[2] <= y <= target[3]


@njit
def _on(
    x: float, y: float, angle: float, speed: float, rate: float, time: float
) -> tuple[float, float]:  # pragma: no cover
    """Return the point after a time of a turn, or of a straight where the rate is 0."""
    if rate == 0.0:
        return x + speed * time * math.cos(angle), y + speed * time * math.sin(angle)
    radius, end = speed / rate, angle + rate * time
    return x + radius * (math.sin(end) - math.sin(angle)), y - radius * (math.cos(end) - math.cos(angle))


@njit
def _arrival(
    x: float, y: float, angle: float, speed: float, rate: float, most: float, step: float, target: Array
) -> float:  # pragma: no cover
    """Return the first time within `most` at which a turn is in the target, +inf for none, looking every `step`."""
    count = math.ceil(most / step)
    for k in range(count + 1):
        px, py = _on(x, y, angle, speed, rate, k * step)
        if _inside(px, py, target):
            low, high = (k - 1) * step, k * step
            if k == 0:
                return 0.0
            for _ in range(30):
                middle = 0.5 * (low + high)
                px, py = _on(x, y, angle, speed, rate, middle)
                if _inside(px, py, target):
                    high = middle
                else:
                    low = middle
            return high
    return np.inf


@njit
def _ahead(x: float, y: float, angle: float, speed: float, target: Array) -> float:  # pragma: no cover
    """Return the first time at which a straight is in the target, +inf for none."""
    cos, sin = math.cos(angle), math.sin(angle)
    if len(target) == 3:
        along, aside = (target[0] - x) * cos + (target[1] - y) * sin, (target[1] - y) * cos - (target[0] - x) * sin
        if abs(aside) > target[2] or along < 0.0:
            return np.inf
        return max(along - math.sqrt(target[2] ** 2 - aside**2), 0.0) / speed
    first, last = 0.0, np.inf
    for k in range(2):
        start, rate = (x, cos) if k == 0 else (y, sin)
        rate = rate if abs(rate) > 1e-12 else 1e-12
        one, two = (target[2 * k] - start) / rate, (target[2 * k + 1] - start) / rate
        first, last = max(first, min(one, two)), min(last, max(one, two))
    return first / speed if first <= last else np.inf


@njit
def _leaves(
    x: float, y: float, angle: float, speed: float, rate: float, time: float, bounds: Array
) -> bool:  # pragma: no cover
    for k in range(91):
        px, py = _on(x, y, angle, speed, rate, time * k / 90.0)
        if not (bounds[0] <= px <= bounds[1] and bounds[2] <= py <= bounds[3]):
            return True
    return False


@njit
def _times(
    states: Array, speed: float, rates: Array, target: Array, bounds: Array, step: float, out: Array
) -> None:  # pragma: no cover
    for i in range(len(states)):
        x, y, angle = states[i]
        best, turn, first, second = np.inf, 0.0, 0.0, 0.0
        for k in range(2):
            rate, other = rates[k], rates[1 - k]
            for j in range(TURNS):
                begin = 2.0 * math.pi / abs(rate) * j / (TURNS - 1)
                if begin >= best:
                    break
                px, py = _on(x, y, angle, speed, rate, begin)
                if _inside(px, py, target):
                    best, turn, first, second = begin, rate, begin, 0.0
                    break
                heading = angle + rate * begin
                time = begin + _ahead(px, py, heading, speed, target)
                if time < best:
                    best, turn, first, second = time, rate, begin, 0.0
                most = min(best - begin, 2.0 * math.pi / abs(other))
                time = begin + _arrival(px, py, heading, speed, other, most, step, target)
                if time < best:
                    best, turn, first, second = time, rate, begin, other
        out[i] = best
        px, py = _on(x, y, angle, speed, turn, first)
        if _leaves(x, y, angle, speed, turn, first, bounds) or _leaves(
            px, py, angle + turn * first, speed, second, best - first, bounds
        ):
            out[i] = np.nan


def draw_dubins(random: np.random.Generator) -> Case:
    """Draw a car and a target of positions."""
    length, speed = draw_scale(random, 1e-1, 1e2), draw_scale(random, 1e-2, 1e2)
    radius = length * random.uniform(0.05, 0.15)
    ratio = draw_scale(random, 1.0, 3.0)
    weak = speed / radius / ratio
    rates = (-weak, weak * ratio) if random.random() < 0.5 else (-weak * ratio, weak)
    left = random.uniform(-1.0, 1.0, 2) * length
    states = (Quantity("x", "m"), Quantity("y", "m"), Quantity("theta", "rad", -np.pi, np.pi, periodic=True))
    axes = (
        *(
            make_axis(state, float(low), float(low + length), int(random.integers(*COUNTS)))
            for state, low in zip(states[:2], left, strict=True)
        ),
        make_axis(states[2], -np.pi, np.pi, int(random.integers(*HEADINGS))),
    )
    boxes = [draw_interval(random, axis, least=3.0, most=6.0, reach=0.4) for axis in axes[:2]]
    disc = None
    if random.random() < 0.5:
        disc = Disc(
            (boxes[0].centre, boxes[1].centre), float(max(a.spacing for a in axes[:2]) * random.uniform(2.0, 3.0))
        )
    shape = np.array([*disc.centre, disc.radius] if disc else [*boxes[0], *boxes[1]])
    edges = [EDGE * axis.spacing for axis in axes[:2]]
    bounds = np.array(
        [axes[0].lower + edges[0], axes[0].upper - edges[0], axes[1].lower + edges[1], axes[1].upper - edges[1]]
    )
    step = 0.5 * min(axis.spacing for axis in axes[:2]) / speed

    def times(x: Array) -> Array:
        out = np.empty(len(x))
        _times(x, float(speed), np.array(rates), shape, bounds, float(step), out)
        return out

    system = make_system("unequal_car", states, [rates], car, {"speed": float(speed)})
    words = numbers(
        speed=float(speed), rates=rates, axes=[(a.lower, a.upper, a.count) for a in axes], target=str(disc or boxes)
    )
    problem = TimeToReachProblem(system, axes, Region({}, disc) if disc else box_target(("x", "y"), boxes))
    return Case(words, problem, times)

"""Boats: rates from a convex set V that is the same everywhere, plus a current; 2 to 4 states; closed forms.

After t seconds a boat can be anywhere in x + t (w + V), so the target K is met from the first t at which that set and K
meet. They meet during one interval of times, as both are convex, and a straight line leads there within any box.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ctrl_rl_core import Disc, Interval, Quantity, Region
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

COUNTS = {2: (81, 162), 3: (41, 62), 4: (15, 18)}
NAMES = ("x", "y", "z", "s")


def meeting_times(x: Array, target: Interval, low: float, high: float) -> tuple[Array, Array]:
    """Return the first and the last time (N,) at which x + t [low, high] meets the interval; (inf, -inf) for never."""
    first, last = np.zeros(x.shape), np.full(x.shape, np.inf)
    for gap, rate in ((target.low - x, high), (x - target.high, -low)):  # gap <= t rate on both sides
        if rate > 0.0:
            first = np.maximum(first, gap / rate)
        elif rate < 0.0:
            last = np.minimum(last, gap / rate)
        else:
            last = np.where(gap > 0.0, -np.inf, last)
    never = first > last
    return np.where(never, np.inf, first), np.where(never, -np.inf, last)


def box_times(x: Array, target: list[Interval], low: Array, high: Array) -> Array:
    """Return times (N,) [s] to meet a box where each state has its own rates."""
    spans = [meeting_times(x[:, k], each, float(low[k]), float(high[k])) for k, each in enumerate(target)]
    first = np.max([span[0] for span in spans], axis=0)
    last = np.min([span[1] for span in spans], axis=0)
    return np.where(first <= last, first, np.inf)


def disc_times(x: Array, disc: Disc, wind: Array, speed: float) -> Array:
    """Return times (N,) [s] to meet a disc at a speed in any direction: the least t with |x - c + w t| <= R + s t."""
    offset = x - disc.centre
    a = float(wind @ wind) - speed * speed
    b = offset @ wind - disc.radius * speed
    c = (offset**2).sum(axis=1) - disc.radius**2
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - a * c)
        # The smaller root for a > 0 and the positive one for a < 0, in the form that does not cancel.
        times = np.where(b < 0.0, c / (-b + root), (-b - root) / a) if a else np.where(b < 0.0, -0.5 * c / b, np.inf)
    times = np.where(np.isnan(times) | (times < 0.0), np.inf, times)
    return np.where(c <= 0.0, 0.0, times)


def ball_times(x: Array, target: list[Interval], wind: Array, speed: float) -> Array:
    """Return times (N,) [s] to meet a box at a speed in any direction: the least t with |x + w t - K| <= s t."""
    lows, highs = np.array(target).T

    def gap(t: Array) -> Array:
        at = x + t[:, None] * wind
        return np.linalg.norm(np.maximum(np.maximum(lows - at, at - highs), 0.0), axis=1) - speed * t

    centre = np.linalg.norm(x - 0.5 * (lows + highs), axis=1)
    drift = float(np.linalg.norm(wind))
    # By then a faster boat has met it; from then on a slower one only gets farther away, once it has passed by.
    until = 2.0 * (centre + np.linalg.norm(highs - lows)) / max(abs(speed - drift), 1e-3 * (speed + drift))
    left, right = np.zeros(len(x)), until.copy()
    for _ in range(200):  # `gap` is convex: the least of it first, by thirds
        one, two = left + (right - left) / 3.0, right - (right - left) / 3.0
        falls = gap(one) > gap(two)
        left, right = np.where(falls, one, left), np.where(falls, right, two)
    least = 0.5 * (left + right)
    reached = gap(least) <= 1e-9 * speed * until
    left, right = np.zeros(len(x)), least
    for _ in range(100):
        middle = 0.5 * (left + right)
        over = gap(middle) > 0.0
        left, right = np.where(over, middle, left), np.where(over, right, middle)
    times = np.where(gap(np.zeros(len(x))) <= 0.0, 0.0, right)
    return np.where(reached, times, np.inf)


def boat2(_m: Any, p: Any) -> Any:
    """Return the equations of two rates."""
    a, b, v, w = p["g0"], p["g1"], p["w0"], p["w1"]
    return lambda _x, u, d: (a * u[0] + v + d[0], b * u[1] + w + d[1])


def boat3(_m: Any, p: Any) -> Any:
    """Return the equations of three rates."""
    a, b, c, v, w, z = p["g0"], p["g1"], p["g2"], p["w0"], p["w1"], p["w2"]
    return lambda _x, u, d: (a * u[0] + v + d[0], b * u[1] + w + d[1], c * u[2] + z + d[2])


def boat4(_m: Any, p: Any) -> Any:
    """Return the equations of four rates."""
    a, b, c, e = p["g0"], p["g1"], p["g2"], p["g3"]
    v, w, z, y = p["w0"], p["w1"], p["w2"], p["w3"]
    return lambda _x, u, d: (a * u[0] + v + d[0], b * u[1] + w + d[1], c * u[2] + z + d[2], e * u[3] + y + d[3])


def draw_boat(random: np.random.Generator) -> Case:
    """Draw a boat with a box of velocities in a current, which may be stronger than the boat on an axis."""
    n = int(random.choice([2, 2, 3, 4]))
    names = NAMES[:n]
    lengths = [draw_scale(random, 1e-2, 1e3) for _ in names]
    bounds = [draw_bounds(random, 100.0 ** (1.0 / n)) for _ in names]
    rate = draw_scale(random, 1e-2, 1e2)
    gains = np.array([random.choice([-1.0, 1.0]) * rate * length for length in lengths])
    strong = bool(random.random() < 0.3)
    current = random.uniform(-0.95, 0.95, n) * np.abs(gains)
    if strong:  # on one axis the boat only gets slower or faster
        axis = int(random.integers(n))
        current[axis] = (
            random.choice([-1.0, 1.0]) * abs(gains[axis]) * max(np.abs(bounds[axis])) * random.uniform(1.1, 2.0)
        )
    rates = np.sort(gains[:, None] * np.array(bounds), axis=1) + current[:, None]
    # Against a disturbance a boat waits in the target where it can stand; else nobody can time its arrival.
    gusts = np.zeros(n)
    if not strong and random.random() < 0.5:
        gusts = random.uniform(0.0, 0.9, n) * np.abs(rates).min(axis=1)
        if n > 2:  # each disturbance doubles what a solver tries at every node: one of them is enough there
            gusts *= np.arange(n) == random.integers(n)
    lefts = [float(random.uniform(-1.0, 1.0) * length) for length in lengths]
    states = [Quantity(name, "m") for name in names]
    axes = tuple(
        make_axis(state, left, left + length, int(random.integers(*COUNTS[n])))
        for state, left, length in zip(states, lefts, lengths, strict=True)
    )
    target = [draw_interval(random, axis, most=8.0 if n == 2 else 4.0) for axis in axes]
    parameters = {f"g{k}": float(g) for k, g in enumerate(gains)} | {f"w{k}": float(w) for k, w in enumerate(current)}
    equations = {2: boat2, 3: boat3, 4: boat4}[n]
    system = make_system("boat", states, bounds, equations, parameters, [(0.0 - float(g), float(g)) for g in gusts])
    words = numbers(
        gains=gains, u=bounds, current=current, d=gusts, axes=[(a.lower, a.upper, a.count) for a in axes], target=target
    )
    problem = TimeToReachProblem(system, axes, box_target(names, target))
    return Case(words, problem, lambda x: box_times(x, target, rates[:, 0] + gusts, rates[:, 1] - gusts))


def steered(m: Any, p: Any) -> Any:
    """Return the equations of a boat whose control is the heading."""
    s, v, w = p["speed"], p["w0"], p["w1"]
    return lambda _x, u, _d: (s * m.cos(u[0]) + v, s * m.sin(u[0]) + w)


def steered_deep(m: Any, p: Any) -> Any:
    """Return the equations of a submarine whose controls are heading and pitch."""
    s, v, w, z = p["speed"], p["w0"], p["w1"], p["w2"]
    return lambda _x, u, _d: (
        s * m.cos(u[0]) * m.cos(u[1]) + v,
        s * m.sin(u[0]) * m.cos(u[1]) + w,
        s * m.sin(u[1]) + z,
    )


def draw_zermelo(random: np.random.Generator) -> Case:
    """Draw Zermelo's boat, in a current that may be stronger than it, to a disc or a box."""
    deep = bool(random.random() < 0.2)
    n = 3 if deep else 2
    length = draw_scale(random, 1e-2, 1e3)
    speed = length * draw_scale(random, 1e-2, 1e2)
    direction = random.normal(size=n)
    wind = (
        direction
        / np.linalg.norm(direction)
        * speed
        * random.choice([random.uniform(0.0, 0.95), random.uniform(1.1, 2.0)])
    )
    lefts = random.uniform(-1.0, 1.0, n) * length
    sides = length * random.uniform(0.6, 1.0, n)
    states = [Quantity(name, "m") for name in NAMES[:n]]
    axes = tuple(
        make_axis(state, float(left), float(left + side), int(random.integers(*COUNTS[n])))
        for state, left, side in zip(states, lefts, sides, strict=True)
    )
    controls = [(-np.pi, np.pi), (-np.pi / 2.0, np.pi / 2.0)][: n - 1]
    parameters = {"speed": speed} | {f"w{k}": float(w) for k, w in enumerate(wind)}
    system = make_system("zermelo", states, controls, steered_deep if deep else steered, parameters)
    boxes = [draw_interval(random, axis, most=8.0 if n == 2 else 4.0) for axis in axes]
    disc = None
    if not deep and random.random() < 0.7:
        radius = float(max(axis.spacing for axis in axes) * random.uniform(1.0, 4.0))
        disc = Disc((boxes[0].centre, boxes[1].centre), radius)
    words = numbers(speed=speed, wind=wind, axes=[(a.lower, a.upper, a.count) for a in axes], target=str(disc or boxes))
    problem = TimeToReachProblem(system, axes, Region({}, disc) if disc else box_target(NAMES[:n], boxes))
    if disc is not None:
        return Case(words, problem, lambda x: disc_times(x, disc, wind, speed))
    return Case(words, problem, lambda x: ball_times(x, boxes, wind, speed))

"""Systems of parts that do not touch one another and must be in their targets at once: carts and lines, 3 and 4 states.

The part that is first has to wait in its target, or arrive later; the supports of what the parts can reach at a time
tell whether both are possible.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ctrl_rl_core import Axis, Interval, Quantity
from referee.carts import EDGE, Cart
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
from referee.linear import Meeting, Part
from ttr_reward_node import TimeToReachProblem

COUNTS = {3: (41, 62), 4: (17, 22)}


def cart_and_line(_m: Any, p: Any) -> Any:
    """Return the equations of a cart and a line."""
    g, h, w = p["g"], p["h"], p["w"]
    return lambda x, u, d: (x[1], g * u[0] + d[1], h * u[1] + w + d[2])


def two_carts(_m: Any, p: Any) -> Any:
    """Return the equations of two carts."""
    g, h = p["g"], p["h"]
    return lambda x, u, d: (x[1], g * u[0] + d[1], x[3], h * u[1] + d[3])


def draw_product(random: np.random.Generator) -> Case:
    """Draw a cart with a line or with a second cart, of other units and other ratios."""
    double = bool(random.random() < 0.5)
    n = 4 if double else 3
    second = draw_scale(random, 1e-1, 1e1)
    bounds, gains, names = [draw_bounds(random, 10.0) for _ in range(2)], [], ("x", "v", "y", "w")[:n]
    states, axes, target, parts, carts = [], [], [], [], []
    for k, kind in enumerate(("cart", "cart" if double else "line")):
        metre = draw_scale(random, 1e-2, 1e2)
        gain = float(random.choice([-1.0, 1.0]) * metre / second ** (2 if kind == "cart" else 1))
        low, high = sorted((gain * bounds[k][0], gain * bounds[k][1]))
        gains.append(gain)
        half = metre * random.uniform(1.0, 2.0)
        centre = float(random.uniform(-1.0, 1.0) * half)
        states.append(Quantity(names[2 * k], "m"))
        axes.append(make_axis(states[-1], centre - half, centre + half, int(random.integers(*COUNTS[n]))))
        target.append(draw_interval(random, axes[-1], most=4.0, reach=0.3))
        if kind == "line":
            wind = float(random.uniform(-0.9, 0.9) * min(-low, high))
            parts.append(_line(low + wind, high + wind, target[-1], 2.0 * half))
            continue
        fast = float(np.sqrt(2.0 * min(-low, high) * half))
        states.append(Quantity(names[2 * k + 1], "m/s"))
        axes.append(make_axis(states[-1], -fast, fast, int(random.integers(*COUNTS[n]))))
        target.append(draw_interval(random, axes[-1], most=4.0, reach=0.0))
        carts.append(_carts(low, high, axes[-2:], target[-2:]))
        parts.append(
            Part(
                np.array([[0.0, 1.0], [0.0, 0.0]]),
                np.array([0.0, 1.0]),
                np.zeros(2),
                low,
                high,
                (target[-2], target[-1]),
                np.array([half, fast]),
            )
        )
    parameters = {"g": gains[0], "h": gains[1]} | ({} if double else {"w": wind})
    system = make_system(
        "two_carts" if double else "cart_and_line", states, bounds, two_carts if double else cart_and_line, parameters
    )
    horizon = 40.0 * second
    meeting = Meeting(parts, horizon / 2000.0, horizon)

    def times(x: Array) -> Array:
        ends = [x[:, :2], x[:, 2:] if double else np.stack((x[:, 2], np.zeros(len(x))), axis=1)]
        found = meeting.times(ends)
        for (bounded, free), end in zip(carts, ends, strict=False):
            own, unbounded = bounded.times(end[:, 0], end[:, 1]), free.times(end[:, 0], end[:, 1])
            found = np.where(np.isinf(own), np.inf, np.where(own <= unbounded * (1.0 + 1e-6), found, np.nan))
        return found

    words = numbers(**parameters, u=bounds, axes=[(a.lower, a.upper, a.count) for a in axes], target=target)
    problem = TimeToReachProblem(system, tuple(axes), box_target(names, target))
    return Case(words, problem, times)


def _line(low: float, high: float, target: Interval, length: float) -> Part:
    """Return a line as a part: its second state stays at 0."""
    column = np.array([1.0, 0.0])
    return Part(
        np.zeros((2, 2)), column, np.zeros(2), low, high, (target, Interval(-1.0, 1.0)), np.array([length, 1.0])
    )


def _carts(brake: float, push: float, axes: list[Axis], target: list[Interval]) -> tuple[Cart, Cart]:
    """Return a cart within the grid and one without bounds."""
    y, v = (Interval(axis.lower, axis.upper) for axis in axes)
    far = Interval(-1e6 * y.length, 1e6 * y.length), Interval(-1e6 * v.length, 1e6 * v.length)
    bounded = Cart(brake, push, y, v, target[0], target[1], EDGE * axes[0].spacing)
    return bounded, Cart(brake, push, *far, target[0], target[1])

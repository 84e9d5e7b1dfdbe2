"""Springs x'' = -k (x - c) - f v + g u, and motors v' = (g u + w - v) / tau, to a box or a disc."""

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
from referee.linear import Meeting, Part
from ttr_reward_node import TimeToReachProblem

COUNTS = (81, 162)


def spring(_m: Any, p: Any) -> Any:
    """Return the equations of a spring; both states are lengths, as in x' = w z, z' = -w (x - c) - f z + g u."""
    w, c, f, g = p["w"], p["c"], p["f"], p["g"]
    return lambda x, u, d: (w * x[1], -w * (x[0] - c) - f * x[1] + g * u[0] + d[1])


def draw_spring(random: np.random.Generator) -> Case:
    """Draw a spring, damped or not, whose weak force has to swing it in or out."""
    length, w = draw_scale(random, 1e-2, 1e3), float(draw_scale(random, 1e-2, 1e2) * random.choice([-1.0, 1.0]))
    bounds = draw_bounds(random, 10.0)
    f = float(abs(w) * random.uniform(0.0, 0.5) * random.integers(0, 2))
    g = float(abs(w) * length * random.choice([-1.0, 1.0]))
    pushes = sorted((g * bounds[0], g * bounds[1]))
    gust = float(random.uniform(0.0, 0.7) * min(-pushes[0], pushes[1]) * random.integers(0, 2))
    low, high = pushes[0] + gust, pushes[1] - gust
    half = 0.5 * (high - low) / abs(w)  # centres of the circles that the two bounds of u lead round
    radius = half * random.uniform(4.0, 8.0)
    c = float(random.uniform(-1.0, 1.0) * radius)
    middle = c + 0.5 * (high + low) / w
    states = (Quantity("x", "m"), Quantity("z", "m"))
    axes = tuple(
        make_axis(state, centre - radius, centre + radius, int(random.integers(*COUNTS)))
        for state, centre in zip(states, (middle, 0.0), strict=True)
    )
    boxes = [draw_interval(random, axis, least=3.0, reach=0.3) for axis in axes]
    disc = None
    if random.random() < 0.5:
        disc = Disc((boxes[0].centre, boxes[1].centre), float(max(a.spacing for a in axes) * random.uniform(2.0, 5.0)))
    target = disc or (boxes[0], boxes[1])
    part = Part(
        np.array([[0.0, w], [-w, -f]]), np.array([0.0, 1.0]), np.array([0.0, w * c]), low, high, target, np.ones(2)
    )
    outer = np.hypot(max(abs(np.array(boxes[0]) - middle)), max(abs(np.array(boxes[1]))))
    if disc is not None:
        outer = np.hypot(disc.centre[0] - middle, disc.centre[1]) + disc.radius
    meeting = Meeting([part], 0.02 / abs(w), np.pi * (radius / (2.0 * half) + 3.0) / abs(w))

    def times(x: Array) -> Array:
        # An arc leads round a centre that is `half` from the middle: no farther out than by two of them.
        leaves = np.maximum(np.hypot(x[:, 0] - middle, x[:, 1]), outer) + 2.0 * half > radius
        return np.where(leaves, np.nan, meeting.times([x]))

    system = make_system(
        "spring", states, [bounds], spring, {"w": w, "c": c, "f": f, "g": g}, [(0.0, 0.0), (0.0 - gust, gust)]
    )
    words = numbers(
        w=w,
        c=c,
        f=f,
        g=g,
        u=bounds,
        d=gust,
        axes=[(a.lower, a.upper, a.count) for a in axes],
        target=str(disc or boxes),
    )
    problem = TimeToReachProblem(system, axes, Region({}, disc) if disc else box_target(("x", "z"), boxes))
    return Case(words, problem, times)


def motor(_m: Any, p: Any) -> Any:
    """Return the equations x' = s v, v' = (g u + w - v) / tau."""
    s, g, w, tau = p["s"], p["g"], p["w"], p["tau"]
    return lambda x, u, d: (s * x[1], (g * u[0] + w - x[1]) / tau + d[1])


def draw_motor(random: np.random.Generator) -> Case:
    """Draw a motor that follows its command with a lag."""
    speed, tau = draw_scale(random, 1e-2, 1e2), draw_scale(random, 1e-2, 1e2)
    s = float(random.choice([-1.0, 1.0]) * draw_scale(random, 1e-2, 1e2))
    bounds = draw_bounds(random, 20.0)
    g = float(random.choice([-1.0, 1.0]) * speed)
    pushes = sorted((g * bounds[0], g * bounds[1]))
    w = float(random.uniform(-0.8, 0.8) * speed * random.integers(0, 2))
    low, high = pushes[0] + w, pushes[1] + w
    gust = float(random.uniform(0.0, 0.7) * min(-low, high) * random.integers(0, 2))
    low, high = low + gust, high - gust
    length = abs(s) * (high - low) * tau * random.uniform(1.0, 4.0)
    left = float(random.uniform(-1.0, 1.0) * length)
    states = (Quantity("x", "m"), Quantity("v", "m/s"))
    axes = (
        make_axis(states[0], left, left + length, int(random.integers(*COUNTS))),
        make_axis(states[1], 1.1 * low, 1.1 * high, int(random.integers(*COUNTS))),
    )
    boxes = [draw_interval(random, axes[0], reach=0.3), draw_interval(random, axes[1], reach=0.0)]
    shift = random.uniform(0.6 * low, 0.6 * high) - boxes[1].centre
    boxes[1] = Interval(boxes[1].low + shift, boxes[1].high + shift)
    part = Part(
        np.array([[0.0, s], [0.0, -1.0 / tau]]),
        np.array([0.0, 1.0 / tau]),
        np.zeros(2),
        low,
        high,
        (boxes[0], boxes[1]),
        np.array([length, high - low]),
    )
    horizon = 3.0 * length / (abs(s) * min(-low, high)) + 5.0 * tau
    meeting = Meeting([part], horizon / 2000.0, horizon)

    def times(x: Array) -> Array:
        # A path goes beyond its ends only to brake from its first speed, or to run up to its last.
        speeds = np.maximum(np.abs(x[:, 1]), max(abs(np.array(boxes[1]))))
        beyond = abs(s) * tau * speeds
        out = (np.minimum(x[:, 0], boxes[0].low) - beyond < left) | (
            np.maximum(x[:, 0], boxes[0].high) + beyond > left + length
        )
        return np.where(out, np.nan, meeting.times([x]))

    parameters = {"s": s, "g": g, "w": w, "tau": tau}
    gusts = [(0.0, 0.0), (0.0 - gust / tau, gust / tau)]
    system = make_system("motor", states, [bounds], motor, parameters, gusts)
    words = numbers(
        s=s, g=g, w=w, tau=tau, u=bounds, d=gust, axes=[(a.lower, a.upper, a.count) for a in axes], target=boxes
    )
    problem = TimeToReachProblem(system, axes, box_target(("x", "v"), boxes))
    return Case(words, problem, times)

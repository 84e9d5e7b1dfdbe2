"""Pendulums with a weak motor, on a circle, and oscillators with a bent spring (Duffing's)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ctrl_rl_core import Interval, Quantity
from referee.case import Array, Case, box_target, draw_interval, draw_scale, make_axis, make_system, numbers
from referee.extremals import Plane
from ttr_reward_node import TimeToReachProblem

COUNTS = (81, 132)


def pendulum(m: Any, p: Any) -> Any:
    """Return the equations x' = v, v' = a sin(x) - f v + b u."""
    a, f, b = p["a"], p["f"], p["b"]
    return lambda x, u, d: (x[1], a * m.sin(x[0]) - f * x[1] + b * u[0] + d[1])


def bent(_m: Any, p: Any) -> Any:
    """Return the equations x' = v, v' = -a (x + x^3 / c^2) - f v + b u."""
    a, f, b, square = p["a"], p["f"], p["b"], p["c"] * p["c"]
    return lambda x, u, d: (x[1], -a * x[0] * (1.0 + x[0] * x[0] / square) - f * x[1] + b * u[0] + d[1])


def draw_pendulum(random: np.random.Generator) -> Case:
    """Draw a pendulum whose motor is weaker than its weight, to any angle and speed."""
    a = float(draw_scale(random, 1e-3, 1e3) * random.choice([-1.0, 1.0]))  # above 0: it stands at 0, below: it hangs
    rate = np.sqrt(abs(a))
    b = float(abs(a) * random.uniform(0.2, 0.9) * random.choice([-1.0, 1.0]))
    bounds = (-random.uniform(0.6, 1.0), random.uniform(0.6, 1.0))
    f = float(rate * random.uniform(0.0, 0.1) * random.integers(0, 2))
    pushes = sorted((b * bounds[0], b * bounds[1]))
    gust = float(random.uniform(0.0, 0.5) * min(-pushes[0], pushes[1]) * random.integers(0, 2))
    states = (Quantity("theta", "rad", -np.pi, np.pi, periodic=True), Quantity("omega", "rad/s"))
    top = float(rate * random.uniform(3.0, 4.0))
    axes = (
        make_axis(states[0], -np.pi, np.pi, int(random.integers(*COUNTS))),
        make_axis(states[1], -top, top, int(random.integers(*COUNTS))),
    )
    boxes = (draw_interval(random, axes[0], 3.0, 12.0, 0.9), draw_interval(random, axes[1], 3.0, 8.0, 0.3))
    parameters = {"a": a, "f": f, "b": b}

    def field(x: Array, v: Array) -> tuple[Array, Array, Array]:
        return a * np.sin(x) - f * v, a * np.cos(x), np.full(x.shape, -f)

    plane = Plane(field, pushes[0] + gust, pushes[1] - gust, boxes, axes)
    return _finish(pendulum, states, bounds, parameters, gust, boxes, plane, 16.0 / rate)


def draw_bent(random: np.random.Generator) -> Case:
    """Draw a spring that stiffens (Duffing's), with friction or without."""
    w, c = float(draw_scale(random, 1e-2, 1e2)), float(draw_scale(random, 1e-2, 1e2))
    a, b = w * w, float(w * w * c * random.uniform(0.2, 1.0) * random.choice([-1.0, 1.0]))
    bounds = (-random.uniform(0.5, 1.0), random.uniform(0.5, 1.0))
    f = float(w * random.uniform(0.0, 0.3) * random.integers(0, 2))
    pushes = sorted((b * bounds[0], b * bounds[1]))
    gust = float(random.uniform(0.0, 0.5) * min(-pushes[0], pushes[1]) * random.integers(0, 2))
    states = (Quantity("x", "m"), Quantity("v", "m/s"))
    axes = (
        make_axis(states[0], -2.5 * c, 2.5 * c, int(random.integers(*COUNTS))),
        make_axis(states[1], -6.0 * w * c, 6.0 * w * c, int(random.integers(*COUNTS))),
    )
    boxes = (draw_interval(random, axes[0], 3.0, 8.0, 0.3), draw_interval(random, axes[1], 3.0, 8.0, 0.3))
    parameters = {"a": a, "f": f, "b": b, "c": c}
    square = c * c

    def field(x: Array, v: Array) -> tuple[Array, Array, Array]:
        return -a * x * (1.0 + x * x / square) - f * v, -a * (1.0 + 3.0 * x * x / square), np.full(x.shape, -f)

    plane = Plane(field, pushes[0] + gust, pushes[1] - gust, boxes, axes)
    return _finish(bent, states, bounds, parameters, gust, boxes, plane, 16.0 / w)


def _finish(
    equations: Any,
    states: tuple[Quantity, Quantity],
    bounds: tuple[float, float],
    parameters: dict[str, float],
    gust: float,
    boxes: tuple[Interval, Interval],
    plane: Plane,
    horizon: float,
) -> Case:
    axes, gusts = plane.axes, [(0.0, 0.0), (0.0 - gust, gust)]
    system = make_system(equations.__name__, states, [bounds], equations, parameters, gusts)
    words = numbers(**parameters, u=bounds, d=gust, axes=[(a.lower, a.upper, a.count) for a in axes], target=boxes)
    names = [state.name for state in states]
    problem = TimeToReachProblem(system, tuple(axes), box_target(names, boxes))
    known: list[Any] = []

    def times(x: Array) -> Array:
        if not known:  # drawing a system is quick; its extremals are found where somebody asks
            known.append(plane.reference(horizon))
        inside = problem.target.contains(names, x)
        return np.where(inside, 0.0, known[0](x))

    return Case(words, problem, times)

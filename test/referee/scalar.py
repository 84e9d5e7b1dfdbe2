"""One state: wind against the control, drift about an equilibrium, controls that enter nonlinearly; all closed forms.

The state can be pushed up at the rate  -a (x - c) + high  and down at  -a (x - c) + low  at most, whatever the
disturbance does; on a line nothing but the two matters.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ctrl_rl_core import Axis, Interval, Quantity
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

COUNTS = (81, 201)
CLEAR = 2.0


def travel_times(start: Array, end: float, drift: float, equilibrium: float, rate: float) -> Array:
    """Return times (N,) [s] from `start` to `end` by x' = -drift (x - equilibrium) + rate; +inf where never."""
    if drift == 0.0:
        with np.errstate(divide="ignore", invalid="ignore"):
            times = (end - start) / rate if rate else np.where(start == end, 0.0, np.inf)
        return np.where(times >= 0.0, times, np.inf)
    rest = equilibrium + rate / drift
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (start - rest) / (end - rest)
        times = np.log(ratio) / drift
    return np.where((ratio > 0.0) & (times >= 0.0), times, np.inf)


def scalar_times(x: Array, target: Interval, drift: float, centre: float, low: float, high: float) -> Array:
    """Return times (N,) [s] to reach the interval where the rates are -drift (x - centre) + [low, high]."""
    below = travel_times(x, target.low, drift, centre, high)
    above = travel_times(x, target.high, drift, centre, low)
    return np.where(x < target.low, below, np.where(x > target.high, above, 0.0))


def draw_clear_interval(
    random: np.random.Generator, axis: Axis, drift: float, centre: float, low: float, high: float
) -> Interval:
    """Return a target that no equilibrium lies beside.

    Where one lies within a cell of the target's ends, that cell decides whether anything arrives at all.
    """
    rests = [centre + rate / drift for rate in (low, high)] if drift else []
    while True:
        target = draw_interval(random, axis)
        if all(abs(rest - end) > CLEAR * axis.spacing for rest in rests for end in target):
            return target


def circle_times(x: Array, target: Interval, period: float, low: float, high: float) -> Array:
    """Return times (N,) [s] to reach an interval of a circle at the rates [low, high]."""
    up = np.mod(target.low - x, period)
    down = np.mod(x - target.high, period)
    inside = np.mod(x - target.low, period) <= target.length
    times = np.minimum(up / high if high > 0.0 else np.inf, down / -low if low < 0.0 else np.inf)
    return np.where(inside, 0.0, times)


def line(_math: Any, p: Any) -> Any:
    """Return the equation x' = s u + w + d."""
    sign, wind = p["sign"], p["wind"]
    return lambda _x, u, d: (sign * u[0] + wind + d[0],)


def lag(_math: Any, p: Any) -> Any:
    """Return the equation x' = -a (x - c) + b u + d."""
    a, b, c = p["a"], p["b"], p["c"]
    return lambda x, u, d: (-a * (x[0] - c) + b * u[0] + d[0],)


def flow(_math: Any, p: Any) -> Any:
    """Return the equation x' = -a (x - c) + d, which has no control."""
    a, c = p["a"], p["c"]
    return lambda x, _u, d: (-a * (x[0] - c) + d[0],)


def draw_line(random: np.random.Generator) -> Case:
    """Draw x' = s u + w + d, on a line or a circle."""
    length, speed = draw_scale(random, 1e-3, 1e4), draw_scale(random, 1e-2, 1e2)
    bounds = draw_bounds(random)
    sign = float(random.choice([-1.0, 1.0])) * speed * length
    pushes = sorted((sign * bounds[0], sign * bounds[1]))
    wind = random.uniform(-0.95, 0.95) * (pushes[1] if random.random() < 0.5 else -pushes[0])
    weaker = min(abs(pushes[0] + wind), abs(pushes[1] + wind))
    gusts = random.uniform(0.0, 0.95, 2) * weaker if random.random() < 0.5 else np.zeros(2)
    low, high = pushes[0] + wind + gusts[1], pushes[1] + wind - gusts[0]
    turning = random.random() < 0.3
    left = random.uniform(-1.0, 1.0) * length
    state = Quantity("phase", "deg", left, left + length, periodic=True) if turning else Quantity("x", "m")
    axis = make_axis(state, left, left + length, int(random.integers(COUNTS[0], COUNTS[1] + 1)))
    target = draw_interval(random, axis)
    system = make_system(
        "line",
        [state],
        [bounds],
        line,
        {"sign": sign, "wind": wind},
        [(0.0 - gusts[0], gusts[1])],
    )
    words = numbers(
        sign=sign,
        u=bounds,
        wind=wind,
        d=(0.0 - gusts[0], gusts[1]),
        axis=(left, left + length),
        count=axis.count,
        circle=turning,
        target=target,
    )
    problem = TimeToReachProblem(system, (axis,), box_target([state.name], [target]))
    if turning:
        return Case(words, problem, lambda x: circle_times(x[:, 0], target, length, low, high))
    return Case(words, problem, lambda x: scalar_times(x[:, 0], target, 0.0, 0.0, low, high))


def draw_lag(random: np.random.Generator) -> Case:
    """Draw x' = -a (x - c) + b u + d, stable or not, with and without control and disturbance."""
    length, rate = draw_scale(random, 1e-3, 1e4), draw_scale(random, 1e-2, 1e2)
    left = random.uniform(-1.0, 1.0) * length
    state = Quantity("level", "m")
    axis = make_axis(state, left, left + length, int(random.integers(COUNTS[0], COUNTS[1] + 1)))
    drift = float(rate * random.choice([-1.0, 1.0, 1.0]))
    centre = float(left + length * random.uniform(0.1, 0.9))
    kind = int(random.integers(0, 3))  # without a control, with a control that is held at 0, with a free one
    bounds = tuple(np.array(draw_bounds(random, 10.0))) if kind == 2 else (0.0, 0.0)
    gain = float(random.choice([-1.0, 1.0]) * rate * length * random.uniform(0.1, 0.5))
    pushes = sorted((gain * bounds[0], gain * bounds[1]))
    gust = random.uniform(0.0, 0.9) * min(-pushes[0], pushes[1]) * random.integers(0, 2)
    low, high = pushes[0] + gust, pushes[1] - gust
    target = draw_clear_interval(random, axis, drift, centre, low, high)
    system = make_system(
        "lag",
        [state],
        [bounds] if kind else [],
        lag if kind else flow,
        {"a": drift, "b": gain, "c": centre},
        [(-gust, gust)],
    )
    words = numbers(
        a=drift,
        c=centre,
        b=gain,
        controls=kind,
        u=bounds,
        d=gust,
        axis=(left, left + length),
        count=axis.count,
        target=target,
    )
    problem = TimeToReachProblem(system, (axis,), box_target([state.name], [target]))
    return Case(words, problem, lambda x: scalar_times(x[:, 0], target, drift, centre, low, high))


SHAPES: dict[str, tuple[Callable[..., Any], float]] = {
    "u^3 - u": (lambda _m, u: u**3 - u, 1.2),
    "|u| u": (lambda _m, u: abs(u) * u, 2.0),
    "sin(u)": (lambda m, u: m.sin(u), 4.0),
    "u^2 - 0.5": (lambda _m, u: u * u - 0.5, 1.5),
    "u exp(-u u)": (lambda m, u: u * m.exp(-u * u), 3.0),
    "cos(2 u) + 0.2 u": (lambda m, u: m.cos(2.0 * u) + 0.2 * u, 3.0),
}
"""How a control enters, and its largest bound."""


def draw_nonlinear(random: np.random.Generator) -> Case:
    """Draw x' = -a (x - c) + b f(u) + w, f with its extremes inside the bounds or not."""
    length, rate = draw_scale(random, 1e-3, 1e4), draw_scale(random, 1e-2, 1e2)
    name = str(random.choice(list(SHAPES)))
    shape, most = SHAPES[name]
    bounds = (-most * random.uniform(0.3, 1.0), most * random.uniform(0.3, 1.0))

    def equations(m: Any, p: Any) -> Any:
        a, b, c, w = p["a"], p["b"], p["c"], p["w"]
        return lambda x, u, _d: (-a * (x[0] - c) + b * shape(m, u[0]) + w,)

    values = shape(np, np.linspace(*bounds, 1_000_001))
    left = random.uniform(-1.0, 1.0) * length
    state = Quantity("x", "m")
    axis = make_axis(state, left, left + length, int(random.integers(COUNTS[0], COUNTS[1] + 1)))
    drift = float(rate * random.uniform(0.0, 0.5) * random.integers(0, 2))
    centre = float(left + length * random.uniform(0.1, 0.9))
    gain = float(random.choice([-1.0, 1.0]) * rate * length)
    pushes = sorted((gain * float(values.min()), gain * float(values.max())))
    wind = float(random.uniform(-0.9, 0.9) * min(abs(pushes[0]), abs(pushes[1])) * random.integers(0, 2))
    low, high = pushes[0] + wind, pushes[1] + wind
    target = draw_clear_interval(random, axis, drift, centre, low, high)
    system = make_system(
        "nonlinear",
        [state],
        [bounds],
        equations,
        {"a": drift, "b": gain, "c": centre, "w": wind},
    )
    words = numbers(
        f=name,
        u=bounds,
        a=drift,
        c=centre,
        b=gain,
        w=wind,
        axis=(left, left + length),
        count=axis.count,
        target=target,
    )
    problem = TimeToReachProblem(system, (axis,), box_target([state.name], [target]))
    return Case(words, problem, lambda x: scalar_times(x[:, 0], target, drift, centre, low, high))

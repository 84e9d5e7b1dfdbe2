"""A system with its problem and a solution that owes the solvers nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ctrl_rl_core.systems import Equations
from numpy.typing import NDArray

from ctrl_rl_core import Axis, Interval, Quantity, Region, System
from ttr_reward_node import TimeToReachProblem

Array = NDArray[np.float64]
Reference = Callable[[Array], Array]
"""Times to reach (N,) [s] of states (N, n): +inf where unreachable, NaN where the reference does not know."""


@dataclass(frozen=True, eq=False)
class Case:
    """A drawn system.

    Attributes:
        words: The numbers that were drawn, for people.
        problem: What the solver is given.
        reference: Exact solution, or one much finer than the solver's.
    """

    words: str
    problem: TimeToReachProblem
    reference: Reference


def make_system(
    name: str,
    states: Sequence[Quantity],
    controls: Sequence[tuple[float, float]],
    equations: Equations,
    parameters: Mapping[str, float],
    disturbances: Sequence[tuple[float, float]] = (),
) -> System:
    """Return a system whose controls u0, u1 .. and disturbances have these bounds; no disturbance unless given."""
    bounds = list(disturbances) or [(0.0, 0.0)] * len(states)
    return System(
        name=name,
        states=tuple(states),
        controls=tuple(Quantity(f"u{k}", "1", *each) for k, each in enumerate(controls)),
        disturbances=tuple(Quantity(f"d_{s.name}", f"{s.unit}/s", *b) for s, b in zip(states, bounds, strict=True)),
        parameters=dict(parameters),
        equations=equations,
    )


def make_axis(state: Quantity, low: float, high: float, count: int) -> Axis:
    """Return the grid's axis of a state."""
    return Axis(state.name, state.unit, low, high, count, state.periodic)


def draw_scale(random: np.random.Generator, least: float, most: float) -> float:
    """Return a number whose logarithm is uniform."""
    return float(np.exp(random.uniform(np.log(least), np.log(most))))


def draw_bounds(random: np.random.Generator, ratio: float = 100.0) -> tuple[float, float]:
    """Return bounds [-low, high] round 0 that differ by a ratio of up to `ratio`, the weaker one being 1."""
    strong = draw_scale(random, 1.0, ratio) if random.random() < 0.7 else 1.0
    return (-1.0, strong) if random.random() < 0.5 else (-strong, 1.0)


def draw_interval(
    random: np.random.Generator, axis: Axis, least: float = 2.0, most: float = 8.0, reach: float = 0.6
) -> Interval:
    """Return an interval of `least` to `most` cells whose centre lies within `reach` of the axis's middle part."""
    half = 0.5 * axis.spacing * random.uniform(least, most)
    middle, width = 0.5 * (axis.lower + axis.upper), 0.5 * (axis.upper - axis.lower)
    centre = middle + reach * width * random.uniform(-1.0, 1.0)
    return Interval(float(centre - half), float(centre + half))


def box_target(names: Sequence[str], intervals: Sequence[Interval]) -> Region:
    """Return a box."""
    return Region(dict(zip(names, intervals, strict=True)))


def numbers(**values: Any) -> str:
    """Return drawn numbers as text."""
    return ", ".join(f"{name}={_short(value)}" for name, value in values.items())


def _short(value: Any) -> str:
    if isinstance(value, str | bool | int):
        return str(value)
    if isinstance(value, float):
        return f"{value:.6g}"
    return "[" + ", ".join(_short(each) for each in np.asarray(value, dtype=object).tolist()) + "]"

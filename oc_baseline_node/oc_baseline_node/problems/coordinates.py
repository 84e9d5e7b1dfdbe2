"""Problem coordinates: angular states, and positions along a corridor's path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import inf, pi
from typing import Any

import numpy as np
from ctrl_rl_core.systems import Dynamics
from ctrl_rl_core.tasks import ANGLES
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import ArcPath, Interval, Quantity, Region, System
from oc_baseline_node.errors import OcError

Array = NDArray[np.float64]
_MOST_WAYS = 4
"""Maximum number of winding combinations tried with several angular states."""


def periods(system: System, positions: Sequence[int]) -> Array:
    """Return the period of each state (n,); inf for a non-angular state.

    A heading of -180 degrees equals one of 180, so an interval also matches values one period away.

    A state is angular if its model says so, or if regions treat its name as an angle. Positions never are, because
    distances are measured along them.
    """
    out = np.full(len(system.states), np.inf)
    for index, state in enumerate(system.states):
        if index in positions:
            continue
        if state.periodic:
            out[index] = state.upper - state.lower
        elif state.name in ANGLES:
            out[index] = 2.0 * np.pi
    return out


def nearest_turn(values: ArrayLike, toward: ArrayLike, period: ArrayLike) -> Array:
    """Shift values (...) by whole periods to within half a period of `toward` (...); ignores infinite periods."""
    values, period = np.asarray(values, dtype=float), np.asarray(period, dtype=float)
    finite = np.isfinite(period)
    length = np.where(finite, period, 1.0)
    return values + np.where(finite, length * np.round((np.asarray(toward) - values) / length), 0.0)


def bounds_around(state: Array, bounds: Array, period: Array) -> Array:
    """Shift bounds (2, n) by whole periods so that they contain or come closest to a state (n,).

    Bounds that span a whole period become infinite.
    """
    low, high = bounds
    free = np.isfinite(period) & (high - low >= period * (1.0 - 1e-9))
    limited = np.isfinite(low) & np.isfinite(high)
    middle = 0.5 * (np.where(limited, low, 0.0) + np.where(limited, high, 0.0))
    turn = middle - nearest_turn(middle, state, period)
    return np.array([np.where(free, -np.inf, low - turn), np.where(free, np.inf, high - turn)])


def outside(region: Region, names: Sequence[str], period: Array, state: Array) -> float:
    """Return the distance of a state (n,) outside a region's intervals [m, rad, ...]; zero or less inside."""
    out = -np.inf
    for name, interval in region.intervals.items():
        index = names.index(name)
        if interval.high - interval.low < period[index]:
            value = float(nearest_turn(state[index], interval.centre, period[index]))
            out = max(out, interval.low - value, value - interval.high)
    return out


def ways_round(
    region: Region, names: Sequence[str], period: Array, state: Array, bounds: Array
) -> list[tuple[float, Region]]:
    """Return copies of a region shifted by periods near a state (n,), with their distances in periods.

    The nearest comes first. Copies outside `bounds` (2, n) are omitted, unless all are outside.
    """
    choices: list[list[tuple[float, str, Interval | None]]] = []
    for name, interval in region.intervals.items():
        index = names.index(name)
        length = period[index]
        if not np.isfinite(length):
            choices.append([(0.0, name, interval)])
        elif interval.high - interval.low >= length:
            choices.append([(0.0, name, None)])
        else:
            choices.append(_turns(name, interval, float(length), float(state[index]), bounds[:, index]))
    ways = [
        (
            sum(distance for distance, *_ in way),
            Region({name: interval for _, name, interval in way if interval is not None}, region.disc),
        )
        for way in product(*choices)
    ]
    return sorted(ways, key=lambda way: way[0])[:_MOST_WAYS]


def _turns(
    name: str, interval: Interval, period: float, value: float, bounds: Array
) -> list[tuple[float, str, Interval | None]]:
    """Return one or two copies of an interval with their distances in periods, nearest first."""
    turn = float(nearest_turn(interval.centre, value, period)) - interval.centre
    found = []
    for shift in (turn - period, turn, turn + period):
        low, high = interval.low + shift, interval.high + shift
        apart = max(low - value, value - high, 0.0) / period
        found.append((max(low, bounds[0]) > min(high, bounds[1]), apart, Interval(low, high)))
    found.sort(key=lambda each: each[:2])
    inside = [each for each in found if not each[0]] or found[:1]
    return [(apart, name, moved) for _, apart, moved in inside[:2]]


_ROUNDED = 0.05
"""Length over which curvature steps are smoothed [m]."""
_LARGEST_HEADING = pi / 3
"""Maximum heading of a start [rad], since a burger does not start across a narrow corridor."""


def path_car(car: System, path: ArcPath) -> System:
    """Return the Dubins car `car` in path coordinates.

    In these coordinates walls become bounds, and the path to the goal becomes a straight line:

        s' = v cos(h) / (1 - kappa(s) l),    l' = v sin(h),    h' = omega - kappa(s) s'

    with s along the path, l lateral to its left, h the heading relative to it (as in the task's regions), and kappa the
    path's curvature, smoothed at its steps for the solver.

    Raises:
        OcError: `car` is a different model.
    """
    if car.name != "dubins_car":
        raise OcError(f"in a corridor the model must be 'dubins_car', not '{car.name}'")
    states = (
        Quantity("s", "m", 0.0, path.length),
        Quantity("lateral", "m", -inf, inf),
        Quantity("heading", "rad", -_LARGEST_HEADING, _LARGEST_HEADING),
    )
    disturbances = tuple(
        replace(given, name=f"d_{state.name}") for given, state in zip(car.disturbances, states, strict=True)
    )

    def equations(math: Any, _parameters: Mapping[str, float]) -> Dynamics:
        def f(x: Any, u: Any, d: Any) -> tuple[Any, ...]:
            kappa = curvature(path, x[0], math)
            rate = u[0] * math.cos(x[2]) / (1.0 - kappa * x[1])
            return rate + d[0], u[0] * math.sin(x[2]) + d[1], u[1] - kappa * rate + d[2]

        return f

    return System("dubins_car along a path", states, car.controls, disturbances, {}, equations)


def curvature(path: ArcPath, s: Any, math: Any = np) -> Any:
    """Return the path's smoothed curvature [rad/m] at s [m], for arrays and CasADi."""
    out, begin = 0.0 * s, 0.0
    for arc in path.arcs:
        if arc.curvature != 0.0:
            ends = (math.tanh((s - at) / _ROUNDED) for at in (begin, begin + arc.length))
            out = out + 0.5 * arc.curvature * (next(ends) - next(ends))
        begin += arc.length
    return out


def in_plane(path: ArcPath, states: ArrayLike) -> NDArray[np.float64]:
    """Return x, y, theta (..., 3) of states s, lateral, heading (..., 3)."""
    s, lateral, heading = np.moveaxis(np.asarray(states, dtype=float), -1, 0)
    x, y, direction = np.moveaxis(path.pose(s), -1, 0)
    return np.stack((x - lateral * np.sin(direction), y + lateral * np.cos(direction), direction + heading), axis=-1)

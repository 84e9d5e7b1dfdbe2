"""States on a circle: a heading of -180 degrees is one of 180, so an interval of it is met a period further, too."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from ctrl_rl_core.tasks.regions import ANGLES
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import Interval, Region, System

Array = NDArray[np.float64]
_MOST_WAYS = 4
"""Ways round that are tried where several states are on circles."""


def periods(system: System, positions: Sequence[int]) -> Array:
    """Return the period of each state (n,), inf where it is on no circle.

    A state is on one where its model says so, or where regions take it for an angle by its name. A position is not:
    distances are measured along it.
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
    """Return values (...) moved by whole periods to within half a period of `toward` (...); unmoved where it is inf."""
    values, period = np.asarray(values, dtype=float), np.asarray(period, dtype=float)
    finite = np.isfinite(period)
    length = np.where(finite, period, 1.0)
    return values + np.where(finite, length * np.round((np.asarray(toward) - values) / length), 0.0)


def bounds_around(state: Array, bounds: Array, period: Array) -> Array:
    """Return bounds (2, n) moved by whole periods so that a state (n,) lies within them, or nearest to them.

    Bounds that hold a whole period bind nothing.
    """
    low, high = bounds
    free = np.isfinite(period) & (high - low >= period * (1.0 - 1e-9))
    limited = np.isfinite(low) & np.isfinite(high)
    middle = 0.5 * (np.where(limited, low, 0.0) + np.where(limited, high, 0.0))
    turn = middle - nearest_turn(middle, state, period)
    return np.array([np.where(free, -np.inf, low - turn), np.where(free, np.inf, high - turn)])


def outside(region: Region, names: Sequence[str], period: Array, state: Array) -> float:
    """Return by how much a state (n,) misses the intervals of a region [m, rad, ...]; zero or less inside."""
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
    """Return a region with its intervals moved by whole periods to where they may be reached from a state (n,).

    Beside each stands its distance in periods; the nearest comes first. Those outside `bounds` (2, n) are left out,
    unless all are.
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
    """Return one or two intervals with their distances in periods, the nearest first."""
    turn = float(nearest_turn(interval.centre, value, period)) - interval.centre
    found = []
    for shift in (turn - period, turn, turn + period):
        low, high = interval.low + shift, interval.high + shift
        apart = max(low - value, value - high, 0.0) / period
        found.append((max(low, bounds[0]) > min(high, bounds[1]), apart, Interval(low, high)))
    found.sort(key=lambda each: each[:2])
    inside = [each for each in found if not each[0]] or found[:1]
    return [(apart, name, moved) for _, apart, moved in inside[:2]]

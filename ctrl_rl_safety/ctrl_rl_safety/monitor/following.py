"""Reachable interval of one speed that follows its commands under a hypothesis.

A hypothesis consists of an interval for the delay, and intervals for the rates at which the speed leaves zero (builds)
and returns to zero (sheds). The speeds that delays and rates within these intervals can produce form an interval again,
because every speed moves towards its command. A measurement outside that interval refutes the hypothesis.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STEP = 0.02
"""Maximum time step of the intervals [s]."""
JITTER = 0.02
"""Maximum deviation of a single command's delay from the constant delay [s]."""
FITS, LEADS, SHEDS_LATE, BUILDS_LATE, GONE = 0, 1, 2, 3, 4
"""Judgements of a hypothesis: it fits; the speed is ahead of it; the speed returns to zero too slowly; the speed leaves
zero too slowly; it was refuted before."""


class Hypotheses(NamedTuple):
    """All combinations of intervals of delay, building rate and shedding rate.

    Attributes:
        delay: Index of the delay's interval of each hypothesis (n,).
        shortest: Shortest delay of each interval (m,) [s].
        longest: Longest delay of each interval (m,) [s].
        build: Lowest and highest rate away from zero (n, 2) [unit/s].
        shed: Lowest and highest rate towards zero (n, 2) [unit/s].
        lag: Time constant of the speed [s].
    """

    delay: NDArray[np.int64]
    shortest: Array
    longest: Array
    build: Array
    shed: Array
    lag: float


@njit
def _limited(value: float, most: float) -> float:
    return min(max(value, -most), most)


@njit
def _slowest(v: float, c: float, build: float, shed: float, share: float, step: float, error: float) -> float:
    """Return the speed after a step towards a command at the lowest rates, with lag and without crossing zero.

    A speed within the measurement error may be zero, and so may already leave zero.
    """
    dv = share * (c - v)
    returns = v * dv < 0.0
    rate = (shed if abs(v) > error else max(shed, build)) if returns else build
    after = v + _limited(dv, step * rate)
    return 0.0 if v * after < 0.0 else after


@njit
def _quickest(v: float, c: float, build: float, shed: float, step: float) -> float:
    """Return the speed after a step towards a command at the highest rates, without lag."""
    dv = c - v
    if v * dv >= 0.0:
        return v + _limited(dv, build * step)
    if abs(dv) <= abs(v) or shed * step < abs(v):
        return v + _limited(dv, shed * step)
    return math.copysign(min(abs(c), build * step), c)


@njit
def _commands(sent: Any, first: float, last: float) -> tuple[float, float]:
    """Return the lowest and the highest command in effect at any time within an interval [s]."""
    least, most = math.inf, -math.inf
    for k in range(len(sent) - 1, -1, -1):
        if sent[k, 0] <= last:
            least, most = min(least, sent[k, 1]), max(most, sent[k, 2])
            if sent[k, 0] <= first:
                break
    return least, most


@cached_njit
def command_range(sent: Array, first: float, last: float) -> tuple[float, float]:
    """Return the lowest and the highest command in effect at any time within an interval [s]; see `advance`."""
    least, most = _commands(sent, first, last)
    return least, most


@cached_njit
def advance(
    those: Any,
    low: Array,
    high: Array,
    sent: Array,
    begin: float,
    end: float,
    gain: float,
    coupled: bool,
    crowded: bool,
    error: float,
) -> tuple[Flags, Flags]:
    """Advance the intervals of all hypotheses in place.

    Args:
        those: The hypotheses.
        low: Lower ends of the speed's intervals (n,) [unit].
        high: Upper ends (n,) [unit].
        sent: Time, lowest and highest value of each command, oldest first (k, 3); the first one also holds before its
            time.
        begin: Time of the intervals [s].
        end: Time to which to advance [s].
        gain: Fraction by which a speed may exceed its command.
        coupled: Whether another speed uses the same force, so that this one may not change at all.
        crowded: Whether another speed takes up the wheels, so that this one may be smaller than any command.
        error: Error bound of a measurement near zero [unit].

    Returns:
        Whether each interval's upper end was falling at the end, and whether its lower end was rising (n,).
    """
    count = max(1, math.ceil((end - begin) / STEP - 1e-9))
    step = (end - begin) / count
    share = -math.expm1(-step / those.lag) if those.lag > 0.0 else 1.0
    if coupled:
        share = 0.0
    falling, rising = np.zeros(len(low), np.bool_), np.zeros(len(low), np.bool_)
    least, most = np.empty(len(those.shortest)), np.empty(len(those.shortest))
    for k in range(count):
        t = begin + k * step
        for i in range(len(least)):
            first, last = t - those.longest[i] - JITTER, t + step - those.shortest[i] + JITTER
            below, above = _commands(sent, first, last)
            least[i] = min(below, below * (1.0 + gain))
            most[i] = max(above, above * (1.0 + gain))
        for i in range(len(low)):
            below, above = least[those.delay[i]], most[those.delay[i]]
            build, shed = those.build[i], those.shed[i]
            falling[i], rising[i] = above < high[i], below > low[i]
            if falling[i]:
                high[i] = _slowest(high[i], above, build[0], shed[0], share, step, error)
            else:
                high[i] = _quickest(high[i], above, build[1], shed[1], step)
            if rising[i]:
                low[i] = _slowest(low[i], below, build[0], shed[0], share, step, error)
            else:
                low[i] = _quickest(low[i], below, build[1], shed[1], step)
            if crowded:
                low[i], high[i] = min(low[i], 0.0), max(high[i], 0.0)
    return falling, rising


@cached_njit
def judge(
    low: Array, high: Array, falling: Flags, rising: Flags, gone: Flags, value: float, error: float
) -> NDArray[np.int8]:
    """Judge each hypothesis (n,) by a measurement, and narrow its interval to the measurement in place.

    Args:
        low: Lower ends of the speed's intervals (n,) [unit].
        high: Upper ends (n,) [unit].
        falling: Whether each upper end was falling (n,).
        rising: Whether each lower end was rising (n,).
        gone: Whether each hypothesis had been refuted before (n,).
        value: Measured speed [unit].
        error: Bound of the measurement's error [unit].
    """
    out = np.zeros(len(low), np.int8)
    for i in range(len(low)):
        if gone[i]:
            out[i] = GONE
            continue
        if value - error > high[i]:
            out[i] = (SHEDS_LATE if value > error else BUILDS_LATE) if falling[i] else LEADS
        elif value + error < low[i]:
            out[i] = (SHEDS_LATE if value < -error else BUILDS_LATE) if rising[i] else LEADS
        if out[i] == FITS:
            low[i], high[i] = max(low[i], value - error), min(high[i], value + error)
        else:
            low[i], high[i] = value - error, value + error
    return out

"""Chooses the answer to a raw command: the command itself, an unblocking turn, a nearby command, or braking."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_safety.filter.certificate import AWAY, best_turn, certify, hold, hopeless
from ctrl_rl_safety.filter.derived_situations import after, from_here, local, smaller
from ctrl_rl_safety.filter.manoeuvres import manoeuvre
from ctrl_rl_safety.filter.situation import Sooner
from ctrl_rl_safety.models.motion import STANDS
from ctrl_rl_safety.sets.distance_field import FAR
from ctrl_rl_safety.sets.recoverable_set import value_at

Array = NDArray[np.float64]

PASSED, CORRECTED, ESCAPING, UNBLOCKING = 1, 2, 3, 4
_SPEEDS, _TURNS = 7, 9
_TRIES = 30
"""Maximum number of motions to certify besides braking, so that an answer takes less than a millisecond."""
_LAST = 0.05
"""Weight of the distance to the last command, used to break ties."""
_RISE = 0.2
"""Fraction of the acceleration with which a corrected speed rises."""
_REFINEMENTS = 4
_ASIDE = math.radians(45.0)
"""Maximum rotation from the heading of the last passed command while braking rotates a disc at rest [rad]."""
_STEADY = 0.3
"""Fraction of a speed down to which it is lowered so that it lasts until the next scan; below, it fluctuates."""


class Request(NamedTuple):
    """A requested command, with the limits and the state of the filter.

    Attributes:
        raw: Requested command, within the limits [m/s, rad/s].
        last: Last command sent [m/s, rad/s].
        corrected: Whether the last command differed from the raw one.
        turn: Turn rate that would unblock a blocked robot; 0 for none [rad/s].
        hysteresis: Margin required for a command to pass again after a correction [m].
        patience: Number of time steps for which a corrected command should be certified, and a raw command must be
            certified to pass again.
        first: Kind of escape to try first.
        slowest: Minimum commanded speed [m/s].
        fastest: Maximum commanded speed [m/s].
        acceleration: Maximum rate of change of the speed away from zero [m/s^2].
        braking: Maximum rate of change of the speed towards zero [m/s^2].
        turn_acceleration: Maximum angular acceleration [rad/s^2].
        turned: Rotation of the robot since a requested command last passed [rad].
        escape: Turn rate that continues the last certified escape; NaN for none [rad/s].
        noise: Margin of a certified escape that noise between two scans may consume [m].
    """

    raw: tuple[float, float]
    last: tuple[float, float]
    corrected: bool
    turn: float
    hysteresis: float
    patience: int
    first: int
    slowest: float
    fastest: float
    acceleration: float
    braking: float
    turn_acceleration: float
    turned: float
    escape: float
    noise: float


class Answer(NamedTuple):
    """A command and its certificate.

    Attributes:
        v: Speed to send [m/s].
        omega: Turn rate to send [rad/s].
        mode: One of PASSED, CORRECTED, ESCAPING and UNBLOCKING.
        margin: Margin of the certificate [m].
        value: Margin of the state according to the recoverable set [m]; NaN without a set.
        kind: Kind of the escape.
        state: State when the command has its first effect.
    """

    v: float
    omega: float
    mode: int
    margin: float
    value: float
    kind: int
    state: tuple[float, float, float, float, float]


@njit
def _numbers(low: float, high: float, count: int, wanted: float) -> Any:
    """Return evenly spaced values from low to high, including zero and the requested value if in range."""
    out = np.empty(count + 2)
    for k in range(count):
        out[k] = low + (high - low) * k / (count - 1)
    out[count] = min(max(0.0, low), high)
    out[count + 1] = min(max(wanted, low), high)
    return out


@njit
def _window(sit: Any, ask: Any, state: tuple[float, float, float, float, float], wanted: tuple[float, float]) -> Any:
    """Return distinguishable speeds and turn rates within the robot's limits until the next command."""
    time = sit.motion.step * (sit.hold + 1.0 / sit.motion.share)
    up, down = ask.acceleration * time, max(ask.acceleration, ask.braking) * time
    around = ask.turn_acceleration * time
    v, omega = state[3], state[4]
    below, above = (up, down) if v < 0.0 else (down, up)
    low_v, high_v = max(ask.slowest, v - below), min(ask.fastest, v + above)
    if ask.corrected:  # a corrected speed rises slowly, so that it does not drop again immediately
        rise = _RISE * up
        low_v, high_v = max(low_v, min(ask.last[0], v, 0.0) - rise), min(high_v, max(ask.last[0], v, 0.0) + rise)
    low_w, high_w = max(-sit.turn_rate, omega - around), min(sit.turn_rate, omega + around)
    return (
        _numbers(min(low_v, high_v), max(low_v, high_v), _SPEEDS, wanted[0]),
        _numbers(min(low_w, high_w), max(low_w, high_w), _TURNS, wanted[1]),
    )


@njit
def _towards(
    sit: Any,
    state: tuple[float, float, float, float, float],
    t: float,
    known: tuple[float, float],
    wanted: tuple[float, float],
    steps: int,
    needed: float,
    margin: float,
    kind: int,
) -> Any:
    """Return the command nearest to the requested one on the line from a certified one, with its margin and escape."""
    share, step = 0.0, 0.5
    for _ in range(_REFINEMENTS):
        tried = share + step
        between = (known[0] + tried * (wanted[0] - known[0]), known[1] + tried * (wanted[1] - known[1]))
        found, which = certify(sit, state, t, between, steps, kind, needed)
        if found >= needed:
            share, margin, kind = tried, found, which
        step *= 0.5
    return known[0] + share * (wanted[0] - known[0]), known[1] + share * (wanted[1] - known[1]), margin, kind


@njit
def _nearest(
    sit: Any,
    ask: Any,
    state: tuple[float, float, float, float, float],
    t: float,
    wanted: tuple[float, float],
    clear: bool,
) -> Any:
    """Return the certified command nearest to a requested one, with margin and escape; margin < 0 for none.

    A command that stays certified until the next scan need not be withdrawn as the scan ages. If the nearest command
    does not stay certified, it is slowed down until it does, unless that would nearly stop the robot.
    """
    speeds, turns = _window(sit, ask, state, wanted)
    wide_v, wide_w = max(speeds.max() - speeds.min(), 1e-3), max(turns.max() - turns.min(), 1e-3)
    costs = np.empty(len(speeds) * len(turns))
    for i in range(len(speeds)):
        for j in range(len(turns)):
            dv, dw = (speeds[i] - wanted[0]) / wide_v, (turns[j] - wanted[1]) / wide_w
            ev, ew = (speeds[i] - ask.last[0]) / wide_v, (turns[j] - ask.last[1]) / wide_w
            costs[i * len(turns) + j] = math.sqrt(dv * dv + dw * dw) + _LAST * math.sqrt(ev * ev + ew * ew)
    stands, tries = abs(state[3]) < STANDS, 0
    for place in np.argsort(costs):
        command = (speeds[place // len(turns)], turns[place % len(turns)])
        # Keeps a robot stopped after a correction from moving because of scan noise.
        needed = ask.hysteresis if stands and ask.corrected and not clear and command[0] != 0.0 else 0.0
        if hopeless(sit, state, command):
            continue
        tries += command[0] != 0.0
        if tries > _TRIES and command[0] != 0.0:
            continue
        margin, kind = certify(sit, state, t, command, sit.hold, ask.first, needed)
        if margin < needed:
            continue
        longer, which = certify(sit, state, t, command, ask.patience, kind, needed)
        if longer >= needed:
            return _towards(sit, state, t, command, wanted, ask.patience, needed, longer, which)
        stop = (0.0, command[1])
        longer, which = certify(sit, state, t, stop, ask.patience, kind, needed)
        if longer >= needed:
            slower = _towards(sit, state, t, stop, command, ask.patience, needed, longer, which)
            if abs(slower[0]) >= _STEADY * abs(command[0]):
                return slower
        return _towards(sit, state, t, command, wanted, sit.hold, needed, margin, kind)
    return 0.0, 0.0, -FAR, ask.first


@njit
def _braking(sit: Any, ask: Any, state: tuple[float, float, float, float, float], t: float) -> Any:
    """Return full braking with the turn rate of largest margin, that margin, and the kind of its escape.

    The turn rates tried include those that continue any escape certified earlier. Turning a disc at rest takes no
    space: the disc turns as requested if the raw command stops it, and by at most `_ASIDE` otherwise. A rectangle at
    rest stops turning, because its corners sweep space.
    """
    to_stand, is_disc = abs(ask.raw[0]) < STANDS, sit.core[0] == 0.0
    if abs(state[3]) < STANDS and (not is_disc or to_stand or abs(ask.turned) > _ASIDE):
        turn = ask.raw[1] if is_disc and to_stand else 0.0
        margin, kind = certify(sit, state, t, (0.0, turn), sit.hold, ask.first, FAR)
        return 0.0, turn, margin, kind
    best, which, turn = -FAR, ask.first, 0.0
    turns = (state[4], best_turn(sit, state) if sit.guide.ready else 0.0, -1.0, 1.0, -0.5, 0.5, 0.0)
    for k in range(len(turns)):
        tried = turns[k] if k < 2 else sit.turn_rate * turns[k]
        margin, kind = certify(sit, state, t, (0.0, tried), sit.hold, ask.first, FAR)
        if margin > best:
            best, which, turn = margin, kind, tried
    return 0.0, turn, best, which


@njit
def _needs_escape(sit: Any, ask: Any, state: tuple[float, float, float, float, float]) -> bool:
    """Return whether the previous certified escape must be kept; a disc at rest needs none."""
    return not math.isnan(ask.escape) and (sit.core[0] > 0.0 or abs(state[3]) >= STANDS)


@njit
def _follow(sit: Any, state: tuple[float, float, float, float, float], t: float, commands: Array) -> Any:
    """Return state, time and minimum margin after the commands under way, one in each time step (n, 2)."""
    least = FAR
    for k in range(len(commands)):
        state, t, margin = hold(sit, state, t, commands[k, 0], commands[k, 1], 1)
        least = min(least, margin)
    return state, t, least


@cached_njit
def answer(sit: Any, ask: Any, begin: Array, t: float, commands: Array, sooner: Array) -> Any:
    """Return the `Answer` to a request.

    Args:
        sit: Echoes, motion and set.
        ask: Requested command.
        begin: State from odometry (5,).
        t: Age of the echoes at that state [s].
        commands: Commands in each time step until a new one takes effect (n, 2).
        sooner: The same for the shortest delay that the robot may have (m, 2); m = n where the delay is known.
    """
    state = (begin[0], begin[1], begin[2], begin[3], begin[4])
    later, later_t, first = _follow(sit, state, t, commands)
    if len(sooner) < len(commands):
        early, early_t, early_first = _follow(sit, state, t, sooner)
        sit, first = after(sit, Sooner(True, early, early_t)), min(first, early_first)
    state, t = later, later_t
    guide, value = sit.guide, math.nan
    if guide.ready:
        value = value_at(guide.values, guide.x, guide.y, guide.cell, guide.top, state[0], state[1], state[2], state[3])
    seen, sit = sit, from_here(sit, state[0], state[1], state[2], t)
    again = ask.corrected and abs(ask.raw[0]) >= STANDS
    extra, steps = (ask.hysteresis, ask.patience) if again else (0.0, sit.hold)
    margin, kind = certify(sit, state, t, ask.raw, steps, ask.first, extra)
    if margin >= extra and ask.turn == 0.0:
        return Answer(ask.raw[0], ask.raw[1], PASSED, min(margin, first), value, kind, state)
    if ask.turn != 0.0:
        margin, kind = certify(sit, state, t, (0.0, ask.turn), sit.hold, ask.first, 0.0)
        if margin >= 0.0:
            return Answer(0.0, ask.turn, UNBLOCKING, min(margin, first), value, kind, state)
    way = manoeuvre(sit, ask, state, t)
    near = local(sit, ask, state, t)
    v, omega, margin, kind = _nearest(near, ask, state, t, (way.v, way.omega), way.clear)
    if margin >= 0.0:
        margin, kind = certify(sit, state, t, (v, omega), sit.hold, kind, 0.0)
        if margin >= 0.0:
            return Answer(v, omega, CORRECTED, min(margin, first), value, kind, state)
    v, omega, margin, kind = _braking(near, ask, state, t)
    margin, kind = certify(sit, state, t, (v, omega), sit.hold, kind, max(margin, 0.0))
    if min(margin, first) < 0.0 and _needs_escape(sit, ask, state):
        found, which = certify(smaller(seen, ask.noise), state, t, (0.0, ask.escape), sit.hold, ask.first, FAR)
        if found >= 0.0:  # otherwise a bound is violated, and the escape is invalid
            omega, margin, kind = ask.escape, min(found - ask.noise, -AWAY), which
    return Answer(v, omega, ESCAPING, min(margin, first), value, kind, state)

"""Two states without a control: turning about a centre, and streams that carry along, on a torus too; closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np

from ctrl_rl_core import Disc, Interval, Quantity, Region
from referee.boats import meeting_times
from referee.case import Array, Case, box_target, draw_interval, draw_scale, make_axis, make_system, numbers
from ttr_reward_node import TimeToReachProblem

COUNTS = (81, 162)
LAPS = 12


def turning_times(x: Array, centre: Array, rate: float, disc: Disc, bounds: Array) -> Array:
    """Return times (N,) [s] to turn into a disc about `centre`; NaN where the circle may leave the bounds (2, 2)."""
    offset, goal = x - centre, np.subtract(disc.centre, centre)
    radius, far = np.hypot(*offset.T), float(np.hypot(*goal))
    with np.errstate(divide="ignore", invalid="ignore"):
        bite = (radius**2 + far**2 - disc.radius**2) / (2.0 * radius * far)
    half = np.arccos(np.clip(bite, -1.0, 1.0))
    ahead = np.mod(np.sign(rate) * (np.arctan2(goal[1], goal[0]) - np.arctan2(offset[:, 1], offset[:, 0])), 2.0 * np.pi)
    inside = np.hypot(*(x - disc.centre).T) <= disc.radius
    times = np.where(bite > 1.0, np.inf, np.maximum(ahead - half, 0.0) / abs(rate))
    leaves = radius > np.min([centre - bounds[0], bounds[1] - centre])
    return np.where(inside, 0.0, np.where(leaves & np.isfinite(times), np.nan, times))


def stream_times(x: Array, target: list[Interval], rates: Array, periods: list[float]) -> Array:
    """Return times (N,) [s] for a stream to carry into a box.

    An axis with a period comes round again; on a torus, where that never ends, NaN after a lap of the quicker axis.
    """
    entries, lasts = [], []
    for k, each in enumerate(target):
        laps = np.arange(0, LAPS) * (periods[k] / abs(rates[k])) if periods[k] else np.zeros(1)
        start = np.mod(x[:, k] - each.low, periods[k]) + each.low if periods[k] else x[:, k]
        spans = [
            meeting_times(start + turn, each, float(rates[k]), float(rates[k])) for turn in (0.0, *_turns(periods[k]))
        ]
        entries.append(np.concatenate([span[0][:, None] + laps for span in spans], axis=1))
        lasts.append(np.concatenate([span[1][:, None] + laps for span in spans], axis=1))
    first = np.maximum(entries[0][:, :, None], entries[1][:, None, :])
    last = np.minimum(lasts[0][:, :, None], lasts[1][:, None, :])
    times = np.where(first <= last, first, np.inf).min(axis=(1, 2))
    if all(periods):
        return np.where(times <= min(p / abs(r) for p, r in zip(periods, rates, strict=True)), times, np.nan)
    return times


def _turns(period: float) -> tuple[float, ...]:
    """Return by how much to move a state that has passed the target already: a period, either way."""
    return (period, -period) if period else ()


def turning(_m: Any, p: Any) -> Any:
    """Return the equations of turning about a centre."""
    w, x0, y0 = p["rate"], p["x0"], p["y0"]
    return lambda x, _u, _d: (-w * (x[1] - y0), w * (x[0] - x0))


def stream(_m: Any, p: Any) -> Any:
    """Return the equations of a stream."""
    v, w = p["w0"], p["w1"]
    return lambda _x, _u, _d: (v, w)


def draw_turning(random: np.random.Generator) -> Case:
    """Draw a rotation into a disc."""
    length, rate = draw_scale(random, 1e-2, 1e3), draw_scale(random, 1e-2, 1e2) * random.choice([-1.0, 1.0])
    left = random.uniform(-1.0, 1.0, 2) * length
    axes = tuple(
        make_axis(Quantity(name, "m"), float(low), float(low + length), int(random.integers(*COUNTS)))
        for name, low in zip("xy", left, strict=True)
    )
    centre = left + length * random.uniform(0.4, 0.6, 2)
    spot = centre + length * random.uniform(0.05, 0.3) * np.array([np.cos(a := random.uniform(0.0, 6.3)), np.sin(a)])
    radius = float(max(axis.spacing for axis in axes) * random.uniform(2.0, 8.0))
    disc = Disc((float(spot[0]), float(spot[1])), radius)
    controls = [] if random.random() < 0.5 else [(0.0, 0.0)]
    parameters = {"rate": float(rate), "x0": float(centre[0]), "y0": float(centre[1])}
    system = make_system("turning", [Quantity(name, "m") for name in "xy"], controls, turning, parameters)
    words = numbers(
        rate=float(rate),
        centre=centre,
        disc=str(disc),
        controls=len(controls),
        axes=[(a.lower, a.upper, a.count) for a in axes],
    )
    bounds = np.array([[axis.lower for axis in axes], [axis.upper for axis in axes]])
    problem = TimeToReachProblem(system, axes, Region({}, disc))
    return Case(words, problem, lambda x: turning_times(x, centre, float(rate), disc, bounds))


def draw_stream(random: np.random.Generator) -> Case:
    """Draw a stream along two axes, either of which may be periodic."""
    lengths, rate = [draw_scale(random, 1e-2, 1e3) for _ in range(2)], draw_scale(random, 1e-2, 1e2)
    rounds = [bool(random.random() < 0.4) for _ in range(2)]
    left = [float(random.uniform(-1.0, 1.0) * length) for length in lengths]
    states = [
        Quantity(f"q{k}", "m", low, low + length, periodic=True) if around else Quantity(f"q{k}", "m")
        for k, (low, length, around) in enumerate(zip(left, lengths, rounds, strict=True))
    ]
    axes = tuple(
        make_axis(state, low, low + length, int(random.integers(*COUNTS)))
        for state, low, length in zip(states, left, lengths, strict=True)
    )
    rates = rate * np.array(lengths) * random.choice([-1.0, 1.0], 2) * random.uniform(0.1, 1.0, 2)
    target = [draw_interval(random, axis, least=5.0, most=20.0) for axis in axes]
    controls = [] if random.random() < 0.5 else [(0.0, 0.0)]
    system = make_system("stream", states, controls, stream, {"w0": float(rates[0]), "w1": float(rates[1])})
    words = numbers(
        rates=rates,
        periodic=rounds,
        controls=len(controls),
        axes=[(a.lower, a.upper, a.count) for a in axes],
        target=target,
    )
    problem = TimeToReachProblem(system, axes, box_target([s.name for s in states], target))
    periods = [length if around else 0.0 for length, around in zip(lengths, rounds, strict=True)]
    return Case(words, problem, lambda x: stream_times(x, target, rates, periods))

"""Steps of a drive: from one scan to another, and the command that acted meanwhile.

A command acts from its time until the next one, or for a second: a base stops by itself then. That of a step is the one
that acted for more than half of it, so that a millisecond between scan and command changes nothing; where no command
did, the mean of those that acted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags.alignment.resampling import TimeSeries

Array = NDArray[np.float64]
Times = NDArray[np.int64]

LONGEST_NS = 1_000_000_000
"""A step between two scans that is longer is a gap; commands and odometry that are older do not count."""
_HALF = 0.5
_LIKE = 0.25
"""Part by which a step may differ from the period that was asked for."""


def acting(commands: TimeSeries, begins: Times, ends: Times, since: Times) -> Array:
    """Return the commands that acted during steps (n, columns); NaN where none did for half of the step.

    Args:
        commands: Commands by the time from which they act.
        begins: Beginnings of the steps (n,) [ns].
        ends: Their ends (n,) [ns].
        since: Time before which commands do not count, such as the last reset of the world (n,) [ns].
    """
    count = len(commands.times)
    out = np.full((len(begins), *commands.values.shape[1:]), np.nan)
    if not count:
        return out
    until = np.minimum(np.append(commands.times[1:], np.iinfo(np.int64).max), commands.times + LONGEST_NS)
    first = np.maximum(np.searchsorted(commands.times, begins, side="right") - 1, 0)
    last = np.searchsorted(commands.times, ends, side="left")
    for row in range(len(begins)):
        some = slice(first[row], max(last[row], first[row]))
        at, values = commands.times[some], commands.values[some]
        shares = np.minimum(until[some], ends[row]) - np.maximum(at, begins[row])
        shares = np.where(at >= since[row], np.maximum(shares, 0), 0) / max(ends[row] - begins[row], 1)
        if shares.sum() < _HALF:
            continue
        longest = int(shares.argmax())
        out[row] = values[longest] if shares[longest] > _HALF else shares @ values / shares.sum()
    return out


def spaced(times: Times, starts: NDArray[np.bool_], period: float) -> NDArray[np.intp]:
    """Return the rows nearest to a row of times a period apart, beginning anew at each start.

    The last row before a start is among them, so that what happened at the end is not lost.

    Args:
        times: Times of the rows (n,) [ns], rising between two starts.
        starts: Whether a row begins a sequence (n,); the first does.
        period: Time between two rows [s].
    """
    kept: list[NDArray[np.intp]] = []
    for piece in np.split(np.arange(len(times)), np.flatnonzero(starts)[1:]):
        here = times[piece]
        steps = round(float(here[-1] - here[0]) / (period * 1e9))
        wanted = here[0] + np.round(np.arange(steps + 1) * period * 1e9).astype(np.int64)
        after = np.clip(np.searchsorted(here, wanted), 1, max(len(here) - 1, 1))
        nearest = after - (wanted - here[after - 1] <= here[np.minimum(after, len(here) - 1)] - wanted)
        kept.append(piece[np.unique(np.append(np.minimum(nearest, len(here) - 1), len(here) - 1))])
    return np.concatenate(kept) if kept else np.empty(0, np.intp)


def even(steps: Array, period: float) -> NDArray[np.bool_]:
    """Return whether each step lasts one period, both in s."""
    return np.asarray(np.abs(steps / period - 1.0) <= _LIKE, dtype=np.bool_)


def odometry_at(series: TimeSeries, times: Times) -> Array:
    """Return odometry (n, 13) at other times: as it came where the stamp is the same, otherwise on the way between two.

    After the last message it stays for a second; NaN where there is none.
    """
    known = series.times
    out = np.full((len(times), series.values.shape[1]), np.nan)
    if not len(known):
        return out
    before = np.searchsorted(known, times, side="right") - 1
    there = (before >= 0) & (times - known[np.maximum(before, 0)] <= LONGEST_NS)
    left = np.maximum(before, 0)
    right = np.minimum(left + 1, len(known) - 1)
    span = known[right] - known[left]
    part = np.where((span > 0) & (span <= LONGEST_NS), (times - known[left]) / np.maximum(span, 1), 0.0)[:, None]
    start, end = series.values[left], series.values[right].copy()
    end[:, 3:7] *= np.where((start[:, 3:7] * end[:, 3:7]).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    between = (1.0 - part) * start + part * end
    between[:, 3:7] /= np.maximum(np.linalg.norm(between[:, 3:7], axis=1, keepdims=True), 1e-12)
    out[there] = np.where(part == 0.0, start, between)[there]
    return out


def latest(series: TimeSeries, times: Times) -> NDArray[np.intp]:
    """Return the number of the last sample at or before each time (n,); -1 where there is none."""
    return np.searchsorted(series.times, times, side="right") - 1

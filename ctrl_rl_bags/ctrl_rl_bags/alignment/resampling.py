"""Time series of one topic, resampling, and commands acting during steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags.format.checks import BagError

Method = Literal["previous", "nearest", "linear"]
Mend = Callable[[NDArray[np.int64], NDArray[Any], Callable[[str], object]], NDArray[Any] | None]
"""Takes times (n,) [ns], rows (n, columns) and a reporting function; returns repaired rows and reports why, or None."""


@dataclass(frozen=True)
class TimeSeries:
    """Samples of one topic of one bag, in log-time order.

    Attributes:
        times: Times (n,) [ns].
        values: Numbers (n, columns), or objects (n,).
        angles: Indices of angular columns, which wrap at pi.
        stamps: Header stamps (n,) [ns]; None without headers.
        jumps: As in `Extractor`.
        log: Log times (n,) [ns], if `times` are different.
        mend: As in `Extractor`.
    """

    times: NDArray[np.int64]
    values: NDArray[Any]
    angles: tuple[int, ...] = ()
    stamps: NDArray[np.int64] | None = None
    jumps: Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.intp]] | None = None
    log: NDArray[np.int64] | None = None
    mend: Mend | None = None

    def some(self, rows: NDArray[np.intp]) -> TimeSeries:
        """Select rows, in the order given."""
        stamps = None if self.stamps is None else self.stamps[rows]
        return replace(self, times=self.times[rows], values=self.values[rows], stamps=stamps, log=None)

    def at(self, rows: NDArray[np.intp], times: NDArray[np.int64]) -> TimeSeries:
        """Select rows, assign other times to them, and sort by these times."""
        order = np.argsort(times, kind="stable")
        stamps = None if self.stamps is None else self.stamps[rows][order]
        log = self.times[rows][order]
        return replace(self, times=times[order], values=self.values[rows][order], stamps=stamps, log=log)

    def mended(self, tell: Callable[[str], object]) -> TimeSeries:
        """Return the series repaired by `Extractor.mend`, and report the repair."""
        values = None if self.mend is None else self.mend(self.times, self.values, tell)
        return self if values is None else replace(self, values=values)

    def across(self, begins: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return whether a jump lies between each begin and end (m,) [ns]."""
        if self.jumps is None:
            return np.zeros(len(begins), dtype=np.bool_)
        after = self.jumps(self.times, self.values)
        # The time of a jump between two samples is unknown.
        left, right = self.times[after - 1], self.times[after]
        return np.asarray(np.searchsorted(left, ends) > np.searchsorted(right, begins, side="right"), dtype=np.bool_)


def resample(
    series: TimeSeries, times: NDArray[np.int64], method: Method = "previous"
) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Sample a series at other times; return values (m, columns) and sample ages (m,) [s].

    Args:
        series: Samples with increasing times.
        times: Sample times (m,) [ns].
        method: `previous` (hold the last sample), `nearest`, or `linear` interpolation.

    Raises:
        BagError: The method is `linear` but the values are not numbers.
    """
    ragged = series.values.dtype == np.object_
    if ragged and method == "linear":
        raise BagError("only numbers can be interpolated: use 'previous' or 'nearest' for scans")
    n = len(series.times)
    if n == 0:
        return _absent(series.values, len(times)), np.full(len(times), np.inf)
    before = np.searchsorted(series.times, times, side="right") - 1
    after = np.clip(before + 1, 0, n - 1)
    left = np.where(before >= 0, (times - series.times[np.maximum(before, 0)]) * 1e-9, np.inf)
    right = np.where(before + 1 < n, (series.times[after] - times) * 1e-9, np.inf)
    if method == "linear":
        age = np.where(left == 0.0, 0.0, np.maximum(left, right))
        values = _interpolate(series, times)
    elif method == "nearest":
        age = np.minimum(left, right)
        values = series.values[np.where(right < left, after, np.maximum(before, 0))]
    else:
        age = left
        values = series.values[np.maximum(before, 0)]
    missing = ~np.isfinite(age)
    values = values.copy()
    values[missing] = None if ragged else np.nan
    return values, age


def _interpolate(series: TimeSeries, times: NDArray[np.int64]) -> NDArray[np.float64]:
    # Relative to the first sample, because 1e18 ns exceed the 53 bits of a float.
    x = (times - series.times[0]).astype(np.float64)
    known = (series.times - series.times[0]).astype(np.float64)
    columns = []
    for column in range(series.values.shape[1]):
        values = series.values[:, column]
        if column in series.angles:
            turned = np.interp(x, known, np.unwrap(values))
            columns.append((turned + np.pi) % (2.0 * np.pi) - np.pi)
        else:
            columns.append(np.interp(x, known, values))
    return np.stack(columns, axis=1)


def _absent(like: NDArray[Any], count: int) -> NDArray[Any]:
    fill = None if like.dtype == np.object_ else np.nan
    return np.full((count, *like.shape[1:]), fill, dtype=like.dtype)


Array = NDArray[np.float64]
Times = NDArray[np.int64]

LONGEST_NS = 1_000_000_000
"""Step between two scans that counts as a gap, and maximum age of commands and odometry [ns]."""
_HALF = 0.5
_LIKE = 0.25
"""Allowed relative deviation of a step from the requested period."""


def acting(commands: TimeSeries, begins: Times, ends: Times, since: Times) -> Array:
    """Return the command acting during each step (n, columns); NaN if none acts for half of the step.

    A command acts from its time until the next one, for at most a second, after which the base stops on its own. A step
    gets the command that acts for more than half of it, so that a millisecond between scan and command is irrelevant;
    if there is none, the step gets the mean of the acting commands.

    Args:
        commands: Commands at the times from which they act.
        begins: Start times of the steps (n,) [ns].
        ends: End times of the steps (n,) [ns].
        since: Time before which commands are ignored, such as the last world reset (n,) [ns].
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
    """Select the rows nearest to a regular grid of times that restarts at each sequence.

    The last row of a sequence is always kept.

    Args:
        times: Times of the rows (n,) [ns], increasing within a sequence.
        starts: Whether a row starts a sequence (n,); the first one does.
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
    """Return whether each step [s] lasts about one period [s]."""
    return np.asarray(np.abs(steps / period - 1.0) <= _LIKE, dtype=np.bool_)


def odometry_at(series: TimeSeries, times: Times) -> Array:
    """Return odometry (n, 13) interpolated at other times.

    The last message is held for a second; NaN without odometry.
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
    """Return the index of the last sample at or before each time (n,); -1 if there is none."""
    return np.searchsorted(series.times, times, side="right") - 1

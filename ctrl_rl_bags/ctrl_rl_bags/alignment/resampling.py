"""One topic's samples over time, and their values at other times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags.format.checks import BagError

Method = Literal["previous", "nearest", "linear"]


@dataclass(frozen=True)
class TimeSeries:
    """Samples of one topic of one bag, in the order of its log time.

    Attributes:
        times: Times (n,) [ns].
        values: Numbers (n, columns), or objects (n,).
        angles: Indices of the columns that are angles and wrap at pi.
        stamps: Times in the messages' headers (n,) [ns]; None without headers.
        jumps: As in `Extractor`.
        log: Log times (n,) [ns], where `times` are others.
    """

    times: NDArray[np.int64]
    values: NDArray[Any]
    angles: tuple[int, ...] = ()
    stamps: NDArray[np.int64] | None = None
    jumps: Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.intp]] | None = None
    log: NDArray[np.int64] | None = None

    def some(self, rows: NDArray[np.intp]) -> TimeSeries:
        """Return the series of these rows, in the order given."""
        stamps = None if self.stamps is None else self.stamps[rows]
        return TimeSeries(self.times[rows], self.values[rows], self.angles, stamps, self.jumps)

    def at(self, rows: NDArray[np.intp], times: NDArray[np.int64]) -> TimeSeries:
        """Return some rows with other times, in the order of these times."""
        order = np.argsort(times, kind="stable")
        stamps = None if self.stamps is None else self.stamps[rows][order]
        return TimeSeries(
            times[order], self.values[rows][order], self.angles, stamps, self.jumps, self.times[rows][order]
        )

    def across(self, begins: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return whether a jump lies between each beginning and end (m,) [ns]."""
        if self.jumps is None:
            return np.zeros(len(begins), dtype=np.bool_)
        after = self.jumps(self.times, self.values)
        # Between the samples before and after a jump, nobody knows when it was.
        left, right = self.times[after - 1], self.times[after]
        return np.asarray(np.searchsorted(left, ends) > np.searchsorted(right, begins, side="right"), dtype=np.bool_)


def resample(
    series: TimeSeries, times: NDArray[np.int64], method: Method = "previous"
) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Return a series' values (m, columns) and their ages (m,) [s] at other times.

    Args:
        series: Samples whose times rise.
        times: Times to sample at (m,) [ns].
        method: `previous` sample held, `nearest` sample, or `linear` interpolation.

    Raises:
        BagError: The method is `linear` and the values are no numbers.
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
    # Relative to the first sample: 1e18 ns do not fit into a float's 53 bits.
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

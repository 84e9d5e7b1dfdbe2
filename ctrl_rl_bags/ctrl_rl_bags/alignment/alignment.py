"""Converts bags to time-aligned arrays: several topics sampled at the times of one of them, or at a fixed rate.

sequences = align("runs/office", ["/scan", "/odom", "/cmd_vel"], reference="/scan", max_step=0.5, max_age=0.2)
for sequence in sequences:  # no sequence spans a gap, an odometry jump, a reset, or two bags
    scans, odometry, commands = (sequence.values[topic] for topic in ("/scan", "/odom", "/cmd_vel"))
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags.alignment.clocks import Clock, Tell, Topics, clock_runs, warn
from ctrl_rl_bags.alignment.resampling import Method, TimeSeries, resample
from ctrl_rl_bags.format.checks import BagError
from ctrl_rl_bags.format.reader import Bag, open_bag

_MOST_ROWS = 100_000_000


@dataclass(frozen=True)
class AlignedSamples:
    """One gapless sequence of samples.

    Attributes:
        times: Times of the rows (n,) [ns], increasing.
        values: Samples by topic (n, columns), or objects (n,); NaN or None before the first sample.
        ages: Age of the sample used, by topic (n,) [s]; for `linear`, of the farther of the two; infinite without a
            sample. Use it to mask stale data.
    """

    times: NDArray[np.int64]
    values: Mapping[str, NDArray[Any]]
    ages: Mapping[str, NDArray[np.float64]]

    def __len__(self) -> int:
        return len(self.times)

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Times since the first row (n,) [s]."""
        return np.asarray((self.times - self.times[:1]) * 1e-9, dtype=np.float64)

    def rows(self, index: slice | NDArray[Any]) -> AlignedSamples:
        """Select rows."""
        return AlignedSamples(
            self.times[index],
            {topic: values[index] for topic, values in self.values.items()},
            {topic: ages[index] for topic, ages in self.ages.items()},
        )

    def split(
        self, max_step: float = np.inf, max_age: float = np.inf, cuts: NDArray[np.bool_] | None = None
    ) -> list[AlignedSamples]:
        """Drop rows with a sample older than `max_age` [s]; split there and at steps above `max_step` [s].

        Args:
            max_step: Maximum step between two rows of a piece [s].
            max_age: Maximum age of a sample [s].
            cuts: Further steps at which to split (n - 1,).
        """
        keep = np.ones(len(self), dtype=np.bool_)
        for ages in self.ages.values():
            keep &= ages <= max_age
        index = np.flatnonzero(keep)
        apart = (np.diff(index) > 1) | (np.diff(self.times[index]) > max_step * 1e9)
        apart |= False if cuts is None else np.append(cuts, False)[index[:-1]]
        pieces = np.split(index, np.flatnonzero(apart) + 1)
        return [self.rows(piece) for piece in pieces if len(piece)]


def align(
    bags: Path | str | Bag | Sequence[Path | str | Bag],
    topics: Topics,
    reference: str | float,
    *,
    methods: Mapping[str, Method] | None = None,
    clock: Clock = "header",
    max_step: float = np.inf,
    max_age: float = np.inf,
    tell: Tell = warn,
) -> list[AlignedSamples]:
    """Sample several topics of one or more bags at common times.

    Args:
        bags: Bags or paths of bags; no sequence spans two.
        topics: Topic names, or names with message extractors (default: `EXTRACTORS` by type).
        reference: Topic that provides the sample times of all others, or a rate [Hz].
        methods: Method by topic: `previous` holds the last sample (default), `nearest`, or `linear` (numbers only).
        clock: `header` for message stamps (log times of topics without stamps are converted to their clock); `log` for
            reception times.
        max_step: Maximum step between two rows of a sequence [s]; a longer step starts a new sequence.
        max_age: Maximum age of a sample [s]; rows with an older sample are dropped. Infinite keeps all rows.
        tell: Called with a line about each omission or split; a Python warning by default.

    Returns:
        The sequences in bag order, each without a gap, an odometry jump or a clock reset.

    Raises:
        BagError: A bag cannot be read or lacks a topic, a topic's type has no extractor, or two clocks differ.
    """
    if isinstance(bags, str | Path | Bag):
        bags = [bags]
    if isinstance(reference, str):
        if reference not in topics:
            raise BagError(f"the reference topic {reference} is not among the topics {', '.join(topics)}")
    elif not reference > 0.0:
        raise BagError(f"the rate must be positive, not {reference} Hz")
    methods = methods or {}
    out: list[AlignedSamples] = []
    for bag in bags:
        with open_bag(bag) as opened:
            runs = clock_runs(opened, topics, reference if isinstance(reference, str) else None, clock, tell)
        for run in runs:
            try:
                times = _sample_times(run, reference, max_age)
            except BagError as error:
                raise BagError(f"{opened.path}: {error}") from None
            cuts = np.zeros(max(len(times) - 1, 0), dtype=np.bool_)
            for topic, series in run.items():
                here = series.across(times[:-1], times[1:])
                if here.any():
                    where = float(times[:-1][here][0] - times[0]) * 1e-9
                    tell(f"{opened.path}: {topic} jumps after {where:.1f} s: the drive is cut there")
                cuts |= here
            values: dict[str, NDArray[Any]] = {}
            ages: dict[str, NDArray[np.float64]] = {}
            for topic, series in run.items():
                values[topic], ages[topic] = resample(series, times, methods.get(topic, "previous"))
            out += AlignedSamples(times, values, ages).split(max_step, max_age, cuts)
    return out


def _sample_times(run: Mapping[str, TimeSeries], reference: str | float, max_age: float) -> NDArray[np.int64]:
    """Return the times of a topic, or those of a rate except for gaps in which a sample would be too old.

    Raises:
        BagError: The rate gives too many rows.
    """
    if isinstance(reference, str):
        return run[reference].times
    filled = [series.times for series in run.values() if len(series.times)]
    if not filled:
        return np.empty(0, dtype=np.int64)
    first, last = max(int(times[0]) for times in filled), min(int(times[-1]) for times in filled)
    step = 1e9 / reference
    parts, count = [], 0
    for begin, end in _without_gaps(filled, first, last, max_age):
        rows = np.array([math.ceil((begin - first) / step), math.floor((end - first) / step + 1e-6) + 1])
        count += max(int(rows[1] - rows[0]), 0)
        if count > _MOST_ROWS:
            raise BagError(f"{(last - first) * 1e-9:.0f} s at {reference:g} Hz are more than {_MOST_ROWS} rows")
        parts.append(first + np.round(np.arange(*rows) * step).astype(np.int64))
    return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)


def _without_gaps(filled: Sequence[NDArray[np.int64]], first: int, last: int, max_age: float) -> list[tuple[int, int]]:
    """Return the spans between `first` and `last` [ns] without a long gap in any topic."""
    gaps = [np.empty((0, 2), dtype=np.int64)]
    for times in filled:
        after = np.flatnonzero(np.diff(times) * 1e-9 > 2.0 * max_age)
        gaps.append(np.stack((times[after], times[after + 1]), axis=1))
    spans, begin = [], first
    for gap in sorted(np.concatenate(gaps).tolist()):
        near = int(gap[0] + min(max_age * 1e9, gap[1] - gap[0]))  # the previous sample is valid for this long
        spans += [(begin, min(near, last))] if near >= begin else []
        begin = max(begin, gap[1])
    return [*spans, (begin, last)] if begin <= last else spans

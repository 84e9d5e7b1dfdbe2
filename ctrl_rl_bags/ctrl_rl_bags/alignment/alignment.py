"""Turns bags into time-aligned arrays: several topics sampled at the times of one of them, or at a fixed rate.

sequences = align("runs/office", ["/scan", "/odom", "/cmd_vel"], reference="/scan", max_step=0.5, max_age=0.2)
for sequence in sequences:  # no sequence reaches across a gap, a jump of the odometry, a reset, or two bags
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
    """One sequence without a gap.

    Attributes:
        times: Times of the rows (n,) [ns], rising.
        values: Samples by topic (n, columns), or objects (n,); NaN or None where there is no sample yet.
        ages: Time to the sample that was used, by topic (n,) [s]; for `linear` to the farther of two; infinite if
            there is none. Mask stale data by it.
    """

    times: NDArray[np.int64]
    values: Mapping[str, NDArray[Any]]
    ages: Mapping[str, NDArray[np.float64]]

    def __len__(self) -> int:
        return len(self.times)

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Times since the first (n,) [s]."""
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
        """Drop rows with a sample older than `max_age` [s]; cut there and at steps above `max_step` [s].

        Args:
            max_step: Maximum step between two rows of a piece [s].
            max_age: Maximum age of a sample [s].
            cuts: Further steps to cut at (n - 1,).
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
        bags: Bags or paths of bags; no sequence reaches across two.
        topics: Names, or names with the extractors of their messages (default: `EXTRACTORS` by type).
        reference: Topic at whose times all others are sampled, or a rate [Hz].
        methods: Method by topic: `previous` sample held (the default), `nearest`, or `linear` (numbers only).
        clock: `header` for message stamps, to whose clock the log times of topics without stamps are converted; `log`
            for the times of reception.
        max_step: Maximum step between two rows of a sequence [s]; a longer one starts a new sequence.
        max_age: Maximum age of a sample [s]; rows with an older one are left out. Infinite keeps all rows.
        tell: Called with a line about what is left out or where a drive is cut; a Python warning by default.

    Returns:
        The sequences in the order of the bags, each without a gap, a jump of the odometry or a reset of the clock.

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
    """Return the times of a topic, or of a rate without the gaps in which a sample would be too old.

    Raises:
        BagError: The rate asks for too many rows.
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
        near = int(gap[0] + min(max_age * 1e9, gap[1] - gap[0]))  # the sample before it counts so long
        spans += [(begin, min(near, last))] if near >= begin else []
        begin = max(begin, gap[1])
    return [*spans, (begin, last)] if begin <= last else spans

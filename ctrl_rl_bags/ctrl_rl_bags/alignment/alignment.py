"""Turns bags into time-aligned arrays to train on: several topics sampled at the times of one, or at a fixed rate.

sequences = align("runs/office", ["/scan", "/odom", "/cmd_vel"], reference="/scan", max_step=0.5, max_age=0.2)
for sequence in sequences:  # no sequence reaches across a gap, a reset of the clock, or two bags
    scans, odometry, commands = (sequence.values[topic] for topic in ("/scan", "/odom", "/cmd_vel"))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags.alignment.clocks import Clock, Topics, clock_runs
from ctrl_rl_bags.alignment.resampling import Method, TimeSeries, resample
from ctrl_rl_bags.format.checks import BagError
from ctrl_rl_bags.format.reader import Bag, open_bag


@dataclass(frozen=True)
class AlignedSamples:
    """One sequence without a gap.

    Attributes:
        times: Times of the rows (n,) [ns], rising.
        values: Samples by topic (n, columns), or objects (n,); NaN or None where there is no sample yet.
        ages: Distance in time to the sample that was used, by topic (n,) [s]; for `linear` to the farther of two,
            infinite where there is none. Mask stale data by it.
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
        """Return some of the rows."""
        return AlignedSamples(
            self.times[index],
            {topic: values[index] for topic, values in self.values.items()},
            {topic: ages[index] for topic, ages in self.ages.items()},
        )

    def split(self, max_step: float = np.inf, max_age: float = np.inf) -> list[AlignedSamples]:
        """Leave out rows with a sample older than `max_age` [s], and cut there and at steps above `max_step` [s]."""
        keep = np.ones(len(self), dtype=np.bool_)
        for ages in self.ages.values():
            keep &= ages <= max_age
        index = np.flatnonzero(keep)
        apart = (np.diff(index) > 1) | (np.diff(self.times[index]) > max_step * 1e9)
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
) -> list[AlignedSamples]:
    """Sample several topics of one or more bags at common times.

    Args:
        bags: Bags or paths of bags; no sequence reaches across two.
        topics: Names, or names with the extractors of their messages (default: `EXTRACTORS` by type).
        reference: Topic at whose times all others are sampled, or a rate [Hz].
        methods: Method by topic: `previous` sample held (the default), `nearest`, or `linear` (numbers only).
        clock: `header` for the messages' own stamps; the log times of a topic without stamps are brought onto their
            clock where that differs, as in simulation. `log` for the times of reception.
        max_step: Largest step between two rows of a sequence [s]; a longer one starts a new sequence.
        max_age: Largest age of a sample [s]; rows with an older one are left out. Infinite keeps all rows.

    Returns:
        The sequences in the order of the bags, each without a gap or a reset of the clock.

    Raises:
        BagError: A bag cannot be read, lacks a topic, or a topic's type has no extractor.
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
            runs = clock_runs(opened, topics, reference if isinstance(reference, str) else None, clock)
        for run in runs:
            times = _sample_times(run, reference)
            values: dict[str, NDArray[Any]] = {}
            ages: dict[str, NDArray[np.float64]] = {}
            for topic, series in run.items():
                values[topic], ages[topic] = resample(series, times, methods.get(topic, "previous"))
            out += AlignedSamples(times, values, ages).split(max_step, max_age)
    return out


def _sample_times(run: Mapping[str, TimeSeries], reference: str | float) -> NDArray[np.int64]:
    if isinstance(reference, str):
        return run[reference].times
    filled = [series.times for series in run.values() if len(series.times)]
    if not filled:
        return np.empty(0, dtype=np.int64)
    first, last = max(int(times[0]) for times in filled), min(int(times[-1]) for times in filled)
    count = int((last - first) * 1e-9 * reference + 1e-6) + 1 if last >= first else 0
    return first + np.round(np.arange(count) * (1e9 / reference)).astype(np.int64)

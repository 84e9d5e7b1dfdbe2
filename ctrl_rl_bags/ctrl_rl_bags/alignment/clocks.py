"""The topics of a bag on one clock, apart for each run of that clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags.alignment.extractors import EXTRACTORS, Extractor
from ctrl_rl_bags.alignment.resampling import TimeSeries
from ctrl_rl_bags.format.checks import BagError, fields_of
from ctrl_rl_bags.format.reader import Bag

Clock = Literal["header", "log"]

_RESET_NS = 500_000_000
"""Stamps of one topic that fall back by more than this: the clock was set back, a simulation was reset.

Several nodes may publish on one topic, and each stamps with the time of its own input: such stamps fall by less."""
_SAME_CLOCK_NS = 1_000_000_000
"""Stamps and log times closer than this are of one clock."""


Topics = Sequence[str] | Mapping[str, Extractor]


def clock_runs(bag: Bag, topics: Topics, reference: str | None, clock: Clock) -> list[dict[str, TimeSeries]]:
    """Return the topics of a bag on one clock, one mapping for each run between two resets of it.

    Args:
        bag: Bag that is open.
        topics: Names of topics, or names with their extractors.
        reference: Topic whose stamps are the clock where it has any.
        clock: `header` for the messages' stamps, `log` for the times of reception.

    Raises:
        BagError: The bag is damaged, or the clock of a topic was set back more or less often than the reference's.
    """
    read = _read(bag, topics)
    stamped = {topic: series for topic, series in read.items() if series.stamps is not None and len(series.times)}
    if clock == "log" or not stamped:
        return [{topic: series.at(np.arange(len(series.times)), series.times) for topic, series in read.items()}]
    base = stamped.get(reference or "") or next(iter(stamped.values()))
    assert base.stamps is not None
    cuts = _resets(base.stamps)
    base_rows = np.split(np.arange(len(base.times)), cuts)
    one_clock = abs(float(np.median(base.times - base.stamps))) < _SAME_CLOCK_NS
    runs: list[dict[str, TimeSeries]] = [{} for _ in base_rows]
    for topic, series in read.items():
        own = np.searchsorted(series.times, base.times[cuts]) if series.stamps is None else _resets(series.stamps)
        if len(own) != len(cuts):
            raise BagError(
                f"{bag.path}: the clock of {topic} was set back {len(own)} times, that of the reference "
                f"{len(cuts)} times: align by clock='log'"
            )
        for run, rows, base_run in zip(runs, np.split(np.arange(len(series.times)), own), base_rows, strict=True):
            if series.stamps is not None:
                times = series.stamps[rows]
            elif one_clock:
                times = series.times[rows]
            else:
                times = _to_clock(series.times[rows], base.times[base_run], base.stamps[base_run])
            run[topic] = series.at(rows, times)
    return runs


def _read(bag: Bag, topics: Topics) -> dict[str, TimeSeries]:
    """Read topics into series over log time."""
    extractors: dict[str, Extractor] = dict(topics) if isinstance(topics, Mapping) else {}
    log: dict[str, list[int]] = {topic: [] for topic in topics}
    stamps: dict[str, list[int]] = {topic: [] for topic in topics}
    values: dict[str, list[Any]] = {topic: [] for topic in topics}
    for message in bag.decoded(topics):
        topic = message.topic
        if topic not in extractors:
            if message.type not in EXTRACTORS:
                raise BagError(
                    f"{bag.path}: no extractor for {topic} ({message.type}): give one as topics={{name: Extractor}}"
                )
            extractors[topic] = EXTRACTORS[message.type]
        log[topic].append(message.log_time)
        with fields_of(f"{bag.path}: a message of {topic}"):
            header = getattr(message.data, "header", None)
            if header is not None:
                stamps[topic].append(header.stamp.sec * 10**9 + header.stamp.nanosec)
            values[topic].append(extractors[topic].read(message.data))
    out = {}
    for topic in topics:
        extractor = extractors.get(topic, Extractor(tuple))
        times = np.array(log[topic], dtype=np.int64)
        own = np.array(stamps[topic], dtype=np.int64) if stamps[topic] else None
        out[topic] = TimeSeries(times, extractor.array(values[topic]), extractor.angles, own)
    return out


def _resets(stamps: NDArray[np.int64]) -> NDArray[np.intp]:
    return np.flatnonzero(np.diff(stamps) < -_RESET_NS) + 1


def _to_clock(log: NDArray[np.int64], known: NDArray[np.int64], stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Bring log times onto the clock of a stamped topic, given that topic's log times and stamps."""
    x, at, value = ((times - origin).astype(np.float64) for times, origin in
                    ((log, known[0]), (known, known[0]), (stamps, stamps[0])))  # fmt: skip
    # Beyond the ends, the clock goes on at its mean pace; held still, it would let the future into the last row.
    pace = value[-1] / at[-1] if at[-1] > 0.0 else 1.0
    out = np.interp(x, at, value) + pace * (np.minimum(x, 0.0) + np.maximum(x - at[-1], 0.0))
    return stamps[0] + np.round(out).astype(np.int64)

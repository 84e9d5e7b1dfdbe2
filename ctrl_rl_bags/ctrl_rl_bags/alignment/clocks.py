"""Converts the topics of a bag to one clock, and splits them at clock resets.

A message has two times: the stamp in its header, and the log time at which the recorder received it. Stamps are
measurement times; log times show whether the stamps of all topics come from one clock.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags.alignment.extractors import EXTRACTORS, Extractor
from ctrl_rl_bags.alignment.resampling import TimeSeries
from ctrl_rl_bags.format.checks import BagError, fields_of, printable
from ctrl_rl_bags.format.reader import Bag
from ctrl_rl_core import CtrlRlError

Clock = Literal["header", "log"]
Topics = Sequence[str] | Mapping[str, Extractor]
Tell = Callable[[str], object]
"""Called with a line about each omission from a bag."""

_RESET_NS = 500_000_000
"""Decrease of a topic's stamps above which the clock was reset.

Several publishers of a topic may use the stamps of their own inputs; such stamps decrease by less.
"""
_RESET_APART_NS = 2_000_000_000
"""Maximum difference in reception time between topics that show the same reset."""
_LATE_S = 0.5
"""Difference between two topics' stamps at the same log time above which their clocks differ [s]."""
_OTHERS = 0.1
"""Fraction of a topic's messages that must differ by this much."""
_FEWEST = 3
_BEGUN_NS = 10_000_000_000
"""Time above which other times must be for a time of 0 to mean that the sender had no clock yet."""
_ADVICE = "--clock log (clock='log') goes by the times of reception"


class BagWarning(UserWarning):
    """Part of a bag is omitted or reinterpreted."""


def warn(line: str) -> None:
    """Issue a Python warning."""
    warnings.warn(line, BagWarning, stacklevel=4)


def clock_runs(
    bag: Bag, topics: Topics, reference: str | None, clock: Clock, tell: Tell = warn, *, paced: bool = False
) -> list[dict[str, TimeSeries]]:
    """Return the topics of a bag on one clock, one mapping per run between two resets.

    Args:
        bag: Open bag.
        topics: Names of topics, or names with their extractors.
        reference: Topic that defines the clock by its stamps, if it has any.
        clock: `header` for message stamps, `log` for reception times.
        tell: Called with lines about omitted messages.
        paced: Whether to convert reception times to the reference's clock, so that slow simulations keep their time
            scale.

    Raises:
        BagError: The bag is damaged, or its topics are stamped by different clocks.
    """
    read = _read(bag, topics, tell)
    stamped = {topic: series for topic, series in read.items() if series.stamps is not None and len(series.times)}
    name = reference if reference in stamped else next(iter(stamped), None)
    if name is None or (clock == "log" and not (paced and reference in stamped)):
        plain = {topic: series.at(np.arange(len(series.times)), series.times) for topic, series in read.items()}
        return [_mended(bag, plain, tell)]
    base = stamped[name]
    assert base.stamps is not None
    cuts = _resets(base.stamps, 0 if paced else _RESET_NS)  # stamps of one lidar never decrease
    bases = [base.some(rows) for rows in np.split(np.arange(len(base.times)), cuts)]
    runs: list[dict[str, TimeSeries]] = [{} for _ in bases]
    late: dict[str, list[NDArray[np.float64]]] = {}
    # In a simulation that runs at 8 times real time, publishers that are a moment apart are so 8 times.
    fall = round(_RESET_NS * max(1.0, *(_pace(known) for known in bases)))
    for topic, series in read.items():
        by_stamp = series.stamps is not None and (clock == "header" or topic == name)
        own = _same_resets(series, base.times[cuts], fall)
        if by_stamp and own is None:
            raise BagError(
                f"{bag.path}: the clock of {printable(topic)} is set back where that of {printable(name)} is not: "
                f"{_ADVICE}"
            )
        own = np.searchsorted(series.times, base.times[cuts]) if own is None or not by_stamp else own
        for run, each, known in zip(runs, np.split(np.arange(len(series.times)), own), bases, strict=True):
            received = _to_clock(series.times[each], known)
            if by_stamp and series.stamps is not None:
                stamps = series.stamps[each]
                # Outside the reference's messages its clock is extrapolated: a simulation may have been paused.
                at = series.times[each]
                met = (at >= known.times[0]) & (at <= known.times[-1]) if len(known.times) else np.zeros(len(at), bool)
                late.setdefault(topic, []).append(
                    np.asarray((stamps - received)[met] * 1e-9, dtype=np.float64) / max(1.0, _pace(known))
                )
                run[topic] = series.at(each, stamps)
            else:
                run[topic] = series.at(each, received)
    _check_one_clock(bag, {topic: np.concatenate(parts) for topic, parts in late.items()}, name, base)
    return [_mended(bag, run, tell) for run in runs]


def _mended(bag: Bag, run: Mapping[str, TimeSeries], tell: Tell) -> dict[str, TimeSeries]:
    """Return a run with repaired series, e.g. with the twist filled in."""

    def told(topic: str) -> Tell:
        return lambda line: tell(f"{bag.path}: {printable(topic)}: {line}")

    return {topic: series.mended(told(topic)) for topic, series in run.items()}


def _read(bag: Bag, topics: Topics, tell: Tell) -> dict[str, TimeSeries]:
    """Read topics into series over log time."""
    extractors: dict[str, Extractor] = dict(topics) if isinstance(topics, Mapping) else {}
    log: dict[str, list[int]] = {topic: [] for topic in topics}
    stamps: dict[str, list[int]] = {topic: [] for topic in topics}
    values: dict[str, list[object]] = {topic: [] for topic in topics}
    refused: dict[str, list[str]] = {}
    for message in bag.decoded(topics):
        topic = message.topic
        if topic not in extractors:
            if message.type not in EXTRACTORS:
                raise BagError(
                    f"{bag.path}: no extractor for {topic} ({message.type}): give one as topics={{name: Extractor}}"
                )
            extractors[topic] = EXTRACTORS[message.type]
        with fields_of(f"{bag.path}: a message of {topic}"):
            header = getattr(message.data, "header", None) if extractors[topic].stamped else None
            try:
                values[topic].append(extractors[topic].read(message.data))
            except CtrlRlError as error:
                refused.setdefault(topic, []).append(str(error))
                continue
            log[topic].append(message.log_time)
            if header is not None:
                stamps[topic].append(header.stamp.sec * 10**9 + header.stamp.nanosec)
    for topic, reasons in refused.items():
        where, count = f"{bag.path}: {printable(topic)}", len(values[topic])
        if not count:
            raise BagError(f"{where}: {reasons[0]}")
        tell(f"{where}: {len(reasons)} of {len(reasons) + count} messages are left out: {reasons[0]}")
    out = {}
    for topic in topics:
        extractor = extractors.get(topic, Extractor(tuple))
        out[topic] = TimeSeries(
            np.array(log[topic], dtype=np.int64),
            extractor.array(values[topic]),
            extractor.angles,
            np.array(stamps[topic], dtype=np.int64) if stamps[topic] else None,
            extractor.jumps,
            mend=extractor.mend,
        )
    return _timed(bag, out, tell)


def _timed(bag: Bag, read: dict[str, TimeSeries], tell: Tell) -> dict[str, TimeSeries]:
    """Drop messages that were received or stamped before their clock had started."""
    received = np.concatenate([series.times for series in read.values()] or [np.empty(0, np.int64)])
    begun = (received > 0).any() and received[received > 0].min() > _BEGUN_NS
    out = {}
    for topic, series in read.items():
        where = f"{bag.path}: {printable(topic)}"
        kept = (series.times > 0) | (not begun)
        if not kept.all():
            tell(f"{where}: {(~kept).sum()} messages were received at time 0 and are left out")
        stamps = series.stamps
        if stamps is not None and len(stamps):
            if (stamps == 0).all():
                if len(stamps) > 1 or begun:
                    tell(f"{where}: its stamps are 0: the times of reception count")
                    series = replace(series, stamps=None)
            elif (without := (stamps == 0) & kept).any() and stamps[stamps != 0].min() > _BEGUN_NS:
                tell(f"{where}: {without.sum()} messages are stamped 0 and are left out")
                kept &= ~without
        rows = np.flatnonzero(kept)
        rows = rows[np.argsort(series.times[rows], kind="stable")]
        out[topic] = series.some(rows)
    return out


def _check_one_clock(bag: Bag, late: Mapping[str, NDArray[np.float64]], name: str, base: TimeSeries) -> None:
    """Raise if the topics of a bag are stamped by different clocks; name the deviating topic.

    Args:
        bag: Bag of the topics.
        late: Difference between each topic's stamps and the reference's at the same reception time [s].
        name: Topic with which the others are compared.
        base: Messages of that topic.

    Raises:
        BagError: Two clocks differ.
    """
    of_others = {topic: each for topic, each in late.items() if topic != name and len(each) >= _FEWEST}
    wrong = {topic: each for topic, each in of_others.items() if (np.abs(each) > _LATE_S).mean() > _OTHERS}
    if not wrong:
        return
    middles = {topic: float(np.median(each[np.abs(each) > _LATE_S])) for topic, each in wrong.items()}
    topic, off = max(middles.items(), key=lambda each: abs(each[1]))
    other = name
    alike = all(abs(each - off) < _LATE_S for each in middles.values())
    assert base.stamps is not None
    base_late = abs(float(np.median(base.times - base.stamps))) * 1e-9
    # If all others disagree with it, the reference is off. Of two topics, the recorder agrees with one.
    if len(of_others) == len(wrong) and alike and (len(wrong) > 1 or abs(base_late - abs(off)) < base_late / 2.0):
        topic, other, off = name, topic, -off
    raise BagError(
        f"{bag.path}: two clocks: {printable(topic)} is stamped {_span(abs(off))} {'ahead of' if off > 0 else 'behind'}"
        f" {printable(other)}, by when both were received; {_ADVICE}"
    )


def _span(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 3600.0 else f"{seconds / 86400.0:.1f} days"


def _resets(stamps: NDArray[np.int64], fall: int = _RESET_NS) -> NDArray[np.intp]:
    return np.flatnonzero(np.diff(stamps) < -fall) + 1


def _same_resets(series: TimeSeries, resets: NDArray[np.int64], fall: int) -> NDArray[np.intp] | None:
    """Match another topic's clock resets by log time to rows of this series; None if the resets differ.

    Args:
        series: Topic whose stamps may fall.
        resets: Log times of the other topic's resets [ns].
        fall: Fall of the stamps from which on it is a reset [ns].
    """
    rows = np.searchsorted(series.times, resets)
    own = _resets(series.stamps, fall) if series.stamps is not None else np.empty(0, np.intp)
    if not len(own):
        return rows
    if not len(resets):
        return None
    nearest = np.abs(series.times[own][:, None] - resets).argmin(axis=1)
    if (np.abs(series.times[own] - resets[nearest]) > _RESET_APART_NS).any():
        return None
    rows[nearest] = own
    return rows


def _pace(known: TimeSeries) -> float:
    """Return the speed of a stamped series' clock relative to reception time."""
    assert known.stamps is not None
    if len(known.times) < 2 or known.times[-1] <= known.times[0]:
        return 1.0
    return float((known.stamps[-1] - known.stamps[0]) / (known.times[-1] - known.times[0])) or 1.0


def _to_clock(log: NDArray[np.int64], known: TimeSeries) -> NDArray[np.int64]:
    """Convert log times to the clock of a stamped series."""
    assert known.stamps is not None
    if not len(known.times) or not len(log):
        return log
    origin, first = known.times[0], known.stamps[0]
    x, at, value = ((each).astype(np.float64) for each in (log - origin, known.times - origin, known.stamps - first))
    # Beyond its ends, the clock continues at its mean rate; holding it would leak the future into the last row.
    out = np.interp(x, at, value) + _pace(known) * (np.minimum(x, 0.0) + np.maximum(x - at[-1], 0.0))
    return first + np.round(out).astype(np.int64)

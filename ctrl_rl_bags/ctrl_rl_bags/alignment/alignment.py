"""Turns bags into time-aligned arrays to train on: several topics sampled at the times of one, or at a fixed rate.

sequences = align("runs/office", ["/scan", "/odom", "/cmd_vel"], reference="/scan", max_step=0.5, max_age=0.2)
for sequence in sequences:  # no sequence reaches across a gap, a reset of the clock, or two bags
    scans, odometry, commands = (sequence.values[topic] for topic in ("/scan", "/odom", "/cmd_vel"))
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from ctrl_rl_core.geometry.odometry import yaw_of
from numpy.typing import NDArray

from ctrl_rl_bags.format.checks import BagError, fields_of
from ctrl_rl_bags.format.reader import read_messages

Method = Literal["previous", "nearest", "linear"]
Clock = Literal["header", "log"]

_RESET_NS = 500_000_000
"""Stamps of one topic that fall back by more than this: the clock was set back, a simulation was reset.

Several nodes may publish on one topic, and each stamps with the time of its own input: such stamps fall by less."""
_SAME_CLOCK_NS = 1_000_000_000
"""Stamps and log times closer than this are of one clock."""


@dataclass(frozen=True)
class Scan:
    """One LaserScan: ranges (n,) [m], bearing of the first and step between them [rad], limits [m] (REP-117)."""

    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float


@dataclass(frozen=True)
class Extractor:
    """What to take out of a message.

    Attributes:
        read: gives a row of numbers, or any object where `columns` is empty.
        columns: names of the numbers.
        angles: which of them are angles [rad] and wrap at pi.
    """

    read: Callable[[Any], Any]
    columns: tuple[str, ...] = ()
    angles: tuple[int, ...] = ()


def _scan(message: Any) -> Scan:
    return Scan(
        np.array(message.ranges, dtype=np.float32),
        float(message.angle_min),
        float(message.angle_increment),
        float(message.range_min),
        float(message.range_max),
    )


def _odometry(message: Any) -> tuple[float, ...]:
    pose, twist = message.pose.pose, message.twist.twist
    return pose.position.x, pose.position.y, yaw_of(pose.orientation), twist.linear.x, twist.angular.z


def _twist(message: Any) -> tuple[float, float]:
    return message.linear.x, message.angular.z


LASER_SCAN = Extractor(_scan)
ODOMETRY = Extractor(_odometry, ("x", "y", "yaw", "v", "omega"), angles=(2,))
TWIST = Extractor(_twist, ("v", "omega"))
TWIST_STAMPED = Extractor(lambda message: _twist(message.twist), ("v", "omega"))
EXTRACTORS: Mapping[str, Extractor] = {
    "sensor_msgs/msg/LaserScan": LASER_SCAN,
    "nav_msgs/msg/Odometry": ODOMETRY,
    "geometry_msgs/msg/Twist": TWIST,
    "geometry_msgs/msg/TwistStamped": TWIST_STAMPED,
}
"""What is taken of a type unless told otherwise; x, y [m], yaw [rad], v [m/s], omega [rad/s] as in REP-103."""


@dataclass(frozen=True)
class TimeSeries:
    """One topic of one bag, in the order of its log time.

    Attributes:
        times: (n,) [ns].
        values: (n, columns), or (n,) objects.
        angles: columns that wrap.
    """

    times: NDArray[np.int64]
    values: NDArray[Any]
    angles: tuple[int, ...] = ()


@dataclass(frozen=True)
class AlignedSamples:
    """One sequence without a gap.

    Attributes:
        times: (n,) [ns], rising.
        values: by topic, (n, columns) of float64, or (n,) objects; NaN or None where there is no sample yet.
        ages: by topic, (n,) [s]: how far away the sample is that was used (linear: the farther of two);
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
    bags: Path | str | Sequence[Path | str],
    topics: Sequence[str] | Mapping[str, Extractor],
    reference: str | float,
    *,
    methods: Mapping[str, Method] | None = None,
    clock: Clock = "header",
    max_step: float = np.inf,
    max_age: float = np.inf,
) -> list[AlignedSamples]:
    """Sample several topics of one or more bags at common times.

    Args:
        bags: one bag or several; no sequence reaches across two.
        topics: names, or names with what to take out of each message (default: `EXTRACTORS` by type).
        reference: the topic at whose times all others are sampled, or a rate [Hz].
        methods: by topic: `previous` sample held (the default), `nearest`, or `linear` (numbers only).
        clock: `header`: the messages' own stamps; a topic without them has its log time, brought onto the clock of
            the stamps where that is another one, simulation time say. `log`: when the recorder received them.
        max_step: a longer step [s] between two rows starts a new sequence.
        max_age: rows with a sample older than this [s] are left out; infinite keeps them, NaN where there is none.

    Returns:
        The sequences in the order of the bags, each without a gap or a reset of the clock.

    Raises:
        BagError: a bag cannot be read, lacks a topic, or a topic's type has no extractor.
    """
    if isinstance(bags, (str, Path)):
        bags = [bags]
    methods = methods or {}
    out: list[AlignedSamples] = []
    for bag in bags:
        for tracks in _runs(bag, topics, reference, clock):
            times = _sample_times(tracks, reference)
            values: dict[str, NDArray[Any]] = {}
            ages: dict[str, NDArray[np.float64]] = {}
            for topic, track in tracks.items():
                values[topic], ages[topic] = resample(track, times, methods.get(topic, "previous"))
            out += AlignedSamples(times, values, ages).split(max_step, max_age)
    return out


def resample(
    track: TimeSeries, times: NDArray[np.int64], method: Method = "previous"
) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Return a track's values and their ages [s] at given times (m,) [ns]; the track's times must rise.

    Raises:
        BagError: `linear` for values that are no numbers.
    """
    ragged = track.values.dtype == np.object_
    if ragged and method == "linear":
        raise BagError("only numbers can be interpolated: use 'previous' or 'nearest' for scans")
    n = len(track.times)
    if n == 0:
        return _absent(track.values, len(times)), np.full(len(times), np.inf)
    before = np.searchsorted(track.times, times, side="right") - 1
    after = np.clip(before + 1, 0, n - 1)
    left = np.where(before >= 0, (times - track.times[np.maximum(before, 0)]) * 1e-9, np.inf)
    right = np.where(before + 1 < n, (track.times[after] - times) * 1e-9, np.inf)
    if method == "linear":
        age = np.where(left == 0.0, 0.0, np.maximum(left, right))
        values = _interpolate(track, times)
    elif method == "nearest":
        age = np.minimum(left, right)
        values = track.values[np.where(right < left, after, np.maximum(before, 0))]
    else:
        age = left
        values = track.values[np.maximum(before, 0)]
    missing = ~np.isfinite(age)
    values = values.copy()
    values[missing] = None if ragged else np.nan
    return values, age


def _interpolate(track: TimeSeries, times: NDArray[np.int64]) -> NDArray[np.float64]:
    # Relative to the first sample: 1e18 ns do not fit into a float's 53 bits.
    x = (times - track.times[0]).astype(np.float64)
    known = (track.times - track.times[0]).astype(np.float64)
    columns = []
    for column in range(track.values.shape[1]):
        values = track.values[:, column]
        if column in track.angles:
            turned = np.interp(x, known, np.unwrap(values))
            columns.append((turned + np.pi) % (2.0 * np.pi) - np.pi)
        else:
            columns.append(np.interp(x, known, values))
    return np.stack(columns, axis=1)


def _absent(like: NDArray[Any], count: int) -> NDArray[Any]:
    fill = None if like.dtype == np.object_ else np.nan
    return np.full((count, *like.shape[1:]), fill, dtype=like.dtype)


def _sample_times(tracks: Mapping[str, TimeSeries], reference: str | float) -> NDArray[np.int64]:
    if isinstance(reference, str):
        return tracks[reference].times
    filled = [track.times for track in tracks.values() if len(track.times)]
    if not filled:
        return np.empty(0, dtype=np.int64)
    first, last = max(int(times[0]) for times in filled), min(int(times[-1]) for times in filled)
    count = int((last - first) * 1e-9 * reference + 1e-6) + 1 if last >= first else 0
    return first + np.round(np.arange(count) * (1e9 / reference)).astype(np.int64)


@dataclass(frozen=True)
class _Read:
    """One topic as read: log times (n,), stamps (n,) or None without headers, values."""

    log: NDArray[np.int64]
    stamps: NDArray[np.int64] | None
    values: NDArray[Any]
    angles: tuple[int, ...]


def _runs(
    bag: Path | str, topics: Sequence[str] | Mapping[str, Extractor], reference: str | float, clock: Clock
) -> list[dict[str, TimeSeries]]:
    """Read the topics of a bag and return their tracks on one clock, apart for each run of that clock."""
    if isinstance(reference, str):
        if reference not in topics:
            raise BagError(f"the reference topic {reference} is not among the topics {', '.join(topics)}")
    elif not reference > 0.0:
        raise BagError(f"the rate must be positive, not {reference} Hz")
    read = _read(bag, topics)
    stamped = {topic: track for topic, track in read.items() if track.stamps is not None and len(track.log)}
    if clock == "log" or not stamped:
        return [{topic: _rising(track.log, track.values, track.angles) for topic, track in read.items()}]
    base = stamped[reference] if isinstance(reference, str) and reference in stamped else next(iter(stamped.values()))
    assert base.stamps is not None
    cuts = _resets(base.stamps)
    clock_runs = np.split(np.arange(len(base.log)), cuts)
    one_clock = abs(float(np.median(base.log - base.stamps))) < _SAME_CLOCK_NS
    runs: list[dict[str, TimeSeries]] = [{} for _ in clock_runs]
    for topic, track in read.items():
        own = np.searchsorted(track.log, base.log[cuts]) if track.stamps is None else _resets(track.stamps)
        if len(own) != len(cuts):
            raise BagError(
                f"{bag}: the clock of {topic} was set back {len(own)} times, that of the reference {len(cuts)} times; "
                "align by clock='log'"
            )
        for run, rows, clock_run in zip(runs, np.split(np.arange(len(track.log)), own), clock_runs, strict=True):
            if track.stamps is not None:
                times = track.stamps[rows]
            elif one_clock:
                times = track.log[rows]
            else:
                times = _to_clock(track.log[rows], base.log[clock_run], base.stamps[clock_run])
            run[topic] = _rising(times, track.values[rows], track.angles)
    return runs


def _read(bag: Path | str, topics: Sequence[str] | Mapping[str, Extractor]) -> dict[str, _Read]:
    chosen = topics if isinstance(topics, Mapping) else {}
    extractors: dict[str, Extractor] = dict(chosen)
    log: dict[str, list[int]] = {topic: [] for topic in topics}
    stamps: dict[str, list[int]] = {topic: [] for topic in topics}
    values: dict[str, list[Any]] = {topic: [] for topic in topics}
    for message in read_messages(bag, topics):
        topic = message.topic
        if topic not in extractors:
            if message.type not in EXTRACTORS:
                raise BagError(
                    f"{bag}: no extractor for {topic} ({message.type}): give one as topics={{name: Extractor}}"
                )
            extractors[topic] = EXTRACTORS[message.type]
        log[topic].append(message.log_time)
        with fields_of(f"{bag}: a message of {topic}"):
            header = getattr(message.data, "header", None)
            if header is not None:
                stamps[topic].append(header.stamp.sec * 10**9 + header.stamp.nanosec)
            values[topic].append(extractors[topic].read(message.data))
    return {
        topic: _Read(
            np.array(log[topic], dtype=np.int64),
            np.array(stamps[topic], dtype=np.int64) if stamps[topic] else None,
            _array(values[topic], extractors.get(topic, Extractor(tuple))),
            extractors.get(topic, Extractor(tuple)).angles,
        )
        for topic in topics
    }


def _array(rows: list[Any], extractor: Extractor) -> NDArray[Any]:
    if extractor.columns:
        return np.array(rows, dtype=np.float64).reshape(len(rows), len(extractor.columns))
    out = np.empty(len(rows), dtype=np.object_)
    out[:] = rows
    return out


def _rising(times: NDArray[np.int64], values: NDArray[Any], angles: tuple[int, ...]) -> TimeSeries:
    order = np.argsort(times, kind="stable")
    return TimeSeries(times[order], values[order], angles)


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

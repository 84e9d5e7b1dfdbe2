"""Timeline of a drive without the scan ranges: which scans are frames, and the events between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from ctrl_rl_core.sensing import ODOMETRY_NAMES, OMEGA_Z, V
from numpy.typing import NDArray

from ctrl_rl_bags.alignment.clocks import Tell, clock_runs
from ctrl_rl_bags.alignment.extractors import Extractor, fill_twist, odometry_jumps
from ctrl_rl_bags.alignment.resampling import LONGEST_NS, TimeSeries, acting, even, latest, odometry_at, spaced
from ctrl_rl_bags.datasets.frames import GOAL_NAMES, states_of
from ctrl_rl_bags.datasets.options import ExtractionOptions, Wiring
from ctrl_rl_bags.datasets.readings import no_goal, read_command, read_goal
from ctrl_rl_bags.format.checks import BagError
from ctrl_rl_bags.format.reader import Bag
from ctrl_rl_core import OdometryHealth, ScanGeometry, read_odometry

Array = NDArray[np.float64]
Times = NDArray[np.int64]

_ALWAYS = np.iinfo(np.int64).min
_SLOWER = 1.25
"""Ratio of scan interval to step length above which scans are too rare for the steps."""

_SELDOM_NS = 150_000_000
"""Interval between odometry messages above which the twist in between is unknown [ns]."""


@dataclass(frozen=True)
class Timeline:
    """Frames of a bag in order, each with the command, reward and outcome since the previous frame.

    Attributes:
        begins: Whether the frame starts an episode (n,); its command, reward and outcome are then undefined.
        times: Times of the scans on the bag's clock (n,) [ns].
        log: Reception times of the scans (n,) [ns].
        stamps: Stamps of the scans (n,) [ns].
        odometry: Pose and twist (n, 13).
        goals: Goals (n, 7); NaN without a goal.
        commands: Commands (n, 2).
        rewards: Rewards (n,); NaN without a reward.
        outcomes: Outcomes as in ctrl_rl_msgs/TaskOutcome (n,).
        pictures: Log times of the images (n,) [ns]; 0 without an image.
    """

    begins: NDArray[np.bool_]
    times: Times
    log: Times
    stamps: Times
    odometry: Array
    goals: Array
    commands: Array
    rewards: Array
    outcomes: Times
    pictures: Times

    def __len__(self) -> int:
        return len(self.times)

    @classmethod
    def joined(cls, parts: list[Timeline]) -> Timeline:
        """Concatenate timelines."""
        return cls(**{each.name: np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)})


@dataclass(frozen=True)
class Read:
    """Timelines of a bag, and statistics of its scans.

    Attributes:
        parts: One timeline per run of the bag's clock; runs without frames are omitted.
        scans: Number of scans.
        left_out: Number of scans in no episode.
        beams: Minimum and maximum number of beams.
        delay: Median time from a scan to the next command [s]; NaN without commands.
        period: Median time between scans [s]; NaN without two scans.
    """

    parts: list[Timeline]
    scans: int
    left_out: int
    beams: tuple[int, int]
    delay: float
    period: float


def read_timeline(bag: Bag, wiring: Wiring, options: ExtractionOptions, pictures: bool, tell: Tell) -> Read:
    """Read the frames of a bag, except for their scans.

    Args:
        bag: Open bag.
        wiring: Topics of the drive.
        options: Clock and step length.
        pictures: Whether a frame requires an image.
        tell: Called with lines about omissions.

    Raises:
        BagError: The bag is damaged, two clocks differ, or the scans are too rare.
    """
    wanted = {name: topic for name, topic in wiring.topics.items() if name != "image" or pictures}
    extractors = {topic: _EXTRACTORS[name](wiring) for name, topic in wanted.items()}
    runs = clock_runs(bag, extractors, wiring.topics["scan"], options.clock, tell, paced=True)
    parts, scans, kept = list[Timeline](), 0, 0
    beams, delays, periods = list[Array](), list[Array](), list[Array]()
    for run in runs:
        series = {name: run[topic] for name, topic in wanted.items()}
        scans += len(series["scan"].times)
        beams.append(series["scan"].values[:, 0])
        periods.append(1e-9 * np.diff(series["scan"].times))
        part, count = _Run(bag, series, options, tell).timeline()
        kept += count
        if part is not None:
            parts.append(part)
            commands, at = series["command"].times, series["scan"].times
            before = np.searchsorted(at, commands, side="right") - 1
            late = np.asarray(commands - at[np.maximum(before, 0)], dtype=np.float64)[before >= 0]
            delays.append(1e-9 * late)
    counts, delay, period = (np.concatenate([np.empty(0), *each]) for each in (beams, delays, periods))
    return Read(
        parts,
        scans,
        scans - kept,
        (int(counts.min(initial=np.inf)), int(counts.max())) if len(counts) else (0, 0),
        float(np.median(delay)) if len(delay) else np.nan,
        float(np.median(period)) if len(period) else np.nan,
    )


class _Run:
    """One run of a bag's clock."""

    def __init__(self, bag: Bag, series: Mapping[str, TimeSeries], options: ExtractionOptions, tell: Tell) -> None:
        self._bag, self._series, self._options, self._tell = bag, series, options, tell
        self._scans = series["scan"]
        self._times, self._log = self._scans.times, self._scans.times if self._scans.log is None else self._scans.log
        self._odometry = odometry_at(series["odom"], self._times)
        self._number, self._since = self._episodes()
        self._outcomes, self._rewards = self._paid()

    def timeline(self) -> tuple[Timeline | None, int]:
        """Return the frames, or None, and the number of scans in their episodes."""
        if len(self._times) < 2:
            return None, 0
        self._check_twist()
        pieces = [piece for piece in self._pieces() if len(piece) > 1]
        if not pieces:
            return None, 0
        count = sum(map(len, pieces))
        parts = [self._frames(piece) for whole in pieces for piece in self._spaced(whole)]
        return (Timeline.joined(parts) if parts else None), count

    def _check_twist(self) -> None:
        """Raise if the twist of odometry contradicts its pose."""
        odometry, health = self._series["odom"], OdometryHealth()
        if len(odometry.times) < 2 or np.median(np.diff(odometry.times)) > _SELDOM_NS:
            return
        for time, row in zip(odometry.times.tolist(), odometry.values, strict=True):
            if fault := health.update(time, row):
                raise BagError(f"{self._bag.path}: {fault}")

    def _episodes(self) -> tuple[NDArray[np.int64], Times]:
        """Return the episode number at each scan, and the start time of that episode."""
        series = self._series.get("episode")
        if series is None or not len(series.times):
            return np.zeros(len(self._times), np.int64), np.full(len(self._times), _ALWAYS)
        numbers = series.values[:, 0].astype(np.int64)
        changed = np.append(True, np.diff(numbers) != 0)
        began = series.times[np.maximum.accumulate(np.where(changed, np.arange(len(numbers)), 0))]
        began = np.where(changed.cumsum() > 1, began, _ALWAYS)  # the start of the first episode is unknown
        last = latest(series, self._times)
        known = np.maximum(last, 0)
        return np.where(last < 0, -1, numbers[known]), np.where(last < 0, _ALWAYS, began[known])

    def _paid(self) -> tuple[Times, Array]:
        """Return the latest outcome and reward at each scan."""
        rewards = np.full((len(self._times), 2), (np.nan, 0.0))
        if (series := self._series.get("reward")) is not None and len(series.times):
            last = latest(series, self._times)
            fresh = (last >= 0) & (series.times[np.maximum(last, 0)] >= self._since)
            rewards[fresh] = series.values[last[fresh]]
        outcomes = rewards[:, 1].astype(np.int64)
        if (series := self._series.get("episode")) is not None and len(series.times):
            last = latest(series, self._times)
            outcomes = np.where(last < 0, 0, series.values[np.maximum(last, 0), 1]).astype(np.int64)
        return outcomes, rewards[:, 0]

    def _pieces(self) -> list[NDArray[np.intp]]:
        """Return the scans of each gapless episode; only the last one may have an outcome."""
        times = self._times
        usable = np.isfinite(self._odometry).all(axis=1)
        usable &= np.append(True, times[1:] > np.maximum.accumulate(times)[:-1])
        if "image" in self._series:
            usable &= latest(self._series["image"], times) >= 0
        begins, ends = times[:-1], times[1:]
        jumps = self._series["odom"].across(begins, ends)
        inside = jumps & (self._number[:-1] == self._number[1:]) & (ends - begins < LONGEST_NS)
        if inside.any():
            where, count = (begins[inside][0] - times[0]) * 1e-9, _count(inside)
            often = "once," if count == 1 else f"{count} times, first"
            self._tell(
                f"{self._bag.path}: the odometry jumps {often} {where:.1f} s after the first scan: the drive is cut "
                "there"
            )
        commands = acting(self._series["command"], begins, ends, self._since[:-1])
        joined = usable[:-1] & usable[1:] & ~jumps & (ends - begins < LONGEST_NS)
        joined &= (self._number[:-1] == self._number[1:]) & np.isfinite(commands).all(axis=1)
        joined &= self._outcomes[:-1] == 0
        return np.split(np.arange(len(times)), np.flatnonzero(~joined) + 1)

    def _spaced(self, piece: NDArray[np.intp]) -> list[NDArray[np.intp]]:
        """Select an episode's scans that are one step apart; split if there is none."""
        period = self._options.period
        usual = float(np.median(np.diff(self._times[piece]))) * 1e-9
        if period is None and not self._options.even:
            return [piece]
        if period is not None and usual > _SLOWER * period:
            raise BagError(
                f"{self._bag.path}: its scans come every {usual:.3g} s, later than a step of {period:.3g} s ends: take"
                f" {usual:.3g} s or more, by the task's time_step or an export's --period"
            )
        if period is not None and not even(np.array([usual]), period).all():
            piece = piece[spaced(self._times[piece], np.arange(len(piece)) == 0, period)]
        fit = even(np.diff(self._times[piece]) * 1e-9, usual if period is None else period)
        fit[-1:] |= self._outcomes[piece[-1:]] != 0  # an outcome may arrive at any time
        return [each for each in np.split(piece, np.flatnonzero(~fit) + 1) if len(each) > 1]

    def _frames(self, rows: NDArray[np.intp]) -> Timeline:
        times = self._times[rows]
        commands = np.full((len(rows), 2), np.nan)
        commands[1:] = acting(self._series["command"], times[:-1], times[1:], self._since[rows[:-1]])
        goals = np.tile(no_goal(), (len(rows), 1))
        if (series := self._series.get("goal_pose")) is not None and len(series.times):
            last = latest(series, times)
            goals[last >= 0] = series.values[last[last >= 0]]
        outcomes = self._outcomes[rows].copy()
        outcomes[-1] = outcomes[-1] or self._outcome_after(int(rows[-1]))
        pictures = np.zeros(len(rows), np.int64)
        if (series := self._series.get("image")) is not None and series.log is not None:
            pictures = series.log[latest(series, times)]
        return Timeline(
            begins=np.arange(len(rows)) == 0,
            times=times,
            log=self._log[rows],
            stamps=np.zeros(len(rows), np.int64) if self._scans.stamps is None else self._scans.stamps[rows],
            odometry=self._odometry[rows],
            goals=goals,
            commands=commands,
            rewards=self._rewards[rows],
            outcomes=outcomes,
            pictures=pictures,
        )

    def _outcome_after(self, row: int) -> int:
        """Return an outcome published after the last scan of an episode; 0 if there was none."""
        series = self._series.get("episode")
        if series is None or not len(series.times):
            return 0
        same = (series.values[:, 0] == self._number[row]) & (series.times > self._times[row])
        ended = np.flatnonzero(same & (series.values[:, 1] != 0))
        if not len(ended):
            return 0
        time = series.times[ended[0]]
        seen = self._times[row + 1 : row + 2]  # a scan before the outcome would have been a frame, or there was a gap
        later = len(seen) > 0 and seen[0] <= time and self._number[row + 1] == self._number[row]
        return 0 if later or time - self._times[row] > LONGEST_NS else int(series.values[ended[0], 1])


def _count(flags: NDArray[np.bool_]) -> int:
    """Return the number of runs of consecutive raised flags."""
    return int(flags[0]) + int((np.diff(flags.astype(np.int8)) > 0).sum())


def _beams(message: Any) -> tuple[float]:
    geometry = ScanGeometry.of(message)
    geometry.check()
    return (float(geometry.beams),)


def _jumps(times: Times, rows: Array) -> NDArray[np.intp]:
    speeds = np.stack((np.linalg.norm(rows[:, 7:10], axis=1), rows[:, 12]), axis=1)
    return odometry_jumps(times, rows[:, :3], states_of(rows)[:, 2].astype(np.float64), speeds)


def _poses(rows: Array) -> Array:
    return np.column_stack((rows[:, :2], states_of(rows)[:, 2]))


_FILL_TWIST = fill_twist(_poses, V, {V: 0, V + 1: 1, OMEGA_Z: 2}, _jumps)


def _command(kind: str) -> Callable[[Any], Any]:
    def read(message: Any) -> Any:
        command = read_command(message, kind)
        return (np.nan, np.nan) if command is None else command

    return read


_PAID = ("number", "outcome")
_EXTRACTORS: Mapping[str, Callable[[Wiring], Extractor]] = {
    "scan": lambda _: Extractor(_beams, ("beams",)),
    "odom": lambda _: Extractor(read_odometry, ODOMETRY_NAMES, jumps=_jumps, mend=_FILL_TWIST),
    "command": lambda wiring: Extractor(_command(wiring.command), ("first", "second")),
    "goal_pose": lambda _: Extractor(read_goal, GOAL_NAMES, stamped=False),
    "reward": lambda _: Extractor(lambda message: (message.reward, message.outcome.value), _PAID),
    "episode": lambda _: Extractor(lambda message: (message.episode, message.outcome.value), _PAID),
    "image": lambda _: Extractor(lambda _: (0.0,), ("picture",)),
}
"""Extractors of a drive's topics."""

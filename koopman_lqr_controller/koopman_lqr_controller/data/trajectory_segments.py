"""Trajectory segments from bags: a policy's observations, and the recorded commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags import EXTRACTORS, AlignedSamples, Extractor, align, bag_info
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import Snapshots
from koopman_lqr_controller.policies.koopman_policy import ObservationFn
from koopman_lqr_controller.sensing.lidar import STEP_TOLERANCE, ScanGeometry
from koopman_lqr_controller.sensing.lidar_mounting import yaw_of_lidar

_EPISODE = Extractor(lambda message: (message.episode, message.outcome.value), ("episode", "outcome"))
_OLDEST = 1.0
"""Commands and odometry older than this do not count: a base stops without them [s]."""


@dataclass(frozen=True)
class TrajectorySegment:
    """Part of a recorded drive without a gap.

    Attributes:
        x: Observation of each scan (T + 1, n).
        u: Commands from each scan to the next (T, 2): speed [m/s], turn rate [rad/s].
        dt: Median time from scan to scan [s].
    """

    x: Array
    u: Array
    dt: float

    def __len__(self) -> int:
        return len(self.u)

    def cut(self, begin: int, end: int) -> TrajectorySegment:
        """Return the steps from `begin` to before `end`."""
        return TrajectorySegment(self.x[begin : end + 1], self.u[begin:end], self.dt)


def load_segments(
    bag: Path, observe: ObservationFn, robot: str = "", lidar_yaw: float | None = None
) -> list[TrajectorySegment]:
    """Return what was seen and commanded in one bag, apart for each sequence without a gap.

    Where the bag holds ground truth about episodes (a simulator's), what follows a collision or the goal is left out;
    so is what has no command or odometry of the last second.

    Args:
        bag: With the topics scan, odom and cmd_vel (Twist or TwistStamped).
        observe: Function from a scan and odometry to an observation.
        robot: Namespace of the topics.
        lidar_yaw: Direction of the scan's zero bearing in the robot's frame [rad]; None for what the bag's /tf_static
            says, and 0 where it says nothing.

    Raises:
        KoopmanError: a topic is missing or holds nothing usable.
        BagError: the bag cannot be read.
    """
    prefix = f"/{robot.strip('/')}" if robot else ""
    scan, odom, command, episode = (f"{prefix}/{name}" for name in ("scan", "odom", "cmd_vel", "episode"))
    info = {name: topic.type for name, topic in bag_info(bag).topics.items()}
    missing = [topic for topic in (scan, odom, command) if topic not in info]
    if missing:
        raise KoopmanError(f"{bag}: no topic {', '.join(missing)}; it has {', '.join(sorted(info))}")
    unknown = [topic for topic in (scan, odom, command) if info[topic] not in EXTRACTORS]
    if unknown:
        known = ", ".join(EXTRACTORS)
        raise KoopmanError(f"{unknown[0]} is of type {info[unknown[0]]}: must be one of {known}")
    extractors = {topic: EXTRACTORS[info[topic]] for topic in (scan, odom, command)}
    if episode in info:
        extractors[episode] = _EPISODE
    stamped = info[command].endswith("TwistStamped")
    yaw = yaw_of_lidar(bag, scan, prefix) if lidar_yaw is None else lidar_yaw
    sequences = align(bag, extractors, reference=scan, methods={odom: "linear"})
    out: list[TrajectorySegment] = []
    for sequence in sequences:
        out += _pieces(sequence, observe, yaw, (scan, odom, command, episode), stamped)
    if not out:
        raise KoopmanError(f"{bag}: no two consecutive scans with odometry and a command: was the robot driven?")
    return out


def to_snapshots(segments: Sequence[TrajectorySegment]) -> list[Snapshots]:
    """Return the snapshots of each drive."""
    return [Snapshots(segment.x[:-1], segment.u, segment.x[1:]) for segment in segments]


def mean_time_step(segments: Sequence[TrajectorySegment]) -> float:
    """Return the time between two steps of drives [s], long ones counting more."""
    return float(np.average([segment.dt for segment in segments], weights=[len(segment) for segment in segments]))


def check_held_out(share: float) -> None:
    """Refuse a part that cannot be held out.

    Raises:
        KoopmanError: it is not in [0, 1).
    """
    if not 0.0 <= share < 1.0:
        raise KoopmanError(f"--held-out is {share}: must be at least 0 and less than 1")


def split(
    segments: Sequence[TrajectorySegment], held_out: float
) -> tuple[list[TrajectorySegment], list[TrajectorySegment]]:
    """Return drives to fit to, and the last part of all steps, to measure on.

    Args:
        segments: In the order of their bags.
        held_out: Part of the steps, 0 <= held_out < 1.
    """
    left = sum(len(segment) for segment in segments) - round(held_out * sum(len(segment) for segment in segments))
    seen: list[TrajectorySegment] = []
    unseen: list[TrajectorySegment] = []
    for segment in segments:
        here = min(max(left, 0), len(segment))
        seen += [segment.cut(0, here)] if here else []
        unseen += [segment.cut(here, len(segment))] if here < len(segment) else []
        left -= here
    return seen, unseen


def _pieces(
    sequence: AlignedSamples, observe: ObservationFn, yaw: float, topics: Sequence[str], stamped: bool
) -> list[TrajectorySegment]:
    scan, odom, command, episode = topics
    odometry, commands = sequence.values[odom], sequence.values[command]
    seen = [_seen(observe, s, yaw, o) for s, o in zip(sequence.values[scan], odometry, strict=True)]
    width = max((len(x) for x in seen if x is not None), default=0)
    if not width:  # no scan shows anything
        return []
    x = np.array([np.full(width, np.nan) if it is None else it for it in seen])
    # A stamped command carries the stamp of the scan it answers; an unstamped one was sent after it, before the next.
    held = slice(None, -1) if stamped else slice(1, None)
    u, step = commands[held], np.diff(sequence.seconds)
    usable = np.isfinite(x[:-1]).all(axis=1) & np.isfinite(x[1:]).all(axis=1) & np.isfinite(u).all(axis=1)
    usable &= (sequence.ages[command][held] < _OLDEST) & (sequence.ages[odom][:-1] < _OLDEST)
    usual = float(np.median(step)) if len(step) else np.nan
    usable &= np.abs(step / usual - 1.0) < STEP_TOLERANCE
    if episode in sequence.values:
        number, outcome = sequence.values[episode].T
        usable &= (number[:-1] == number[1:]) & (outcome[1:] == 0)
    cuts = np.flatnonzero(~usable)
    runs = np.split(np.arange(len(usable)), np.unique(np.concatenate((cuts, cuts + 1))))
    return [
        TrajectorySegment(x[rows[0] : rows[-1] + 2], u[rows], usual)
        for rows in runs
        if len(rows) and usable[rows].all()
    ]


def _seen(observe: ObservationFn, scan: Any, yaw: float, odometry: NDArray[np.float64]) -> Array | None:
    """Return x of one sample, None where the scan shows nothing."""
    bearing = scan.angle_min + yaw
    geometry = ScanGeometry(len(scan.ranges), bearing, scan.angle_increment, scan.range_min, scan.range_max)
    try:
        return observe(scan.ranges, geometry, odometry[3], odometry[4])
    except KoopmanError:
        return None

"""Trajectory segments from bags: a policy's observations, and the recorded commands."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_bags.alignment import Tell, warn
from ctrl_rl_bags.datasets import (
    ACTION,
    ODOMETRY,
    OUTCOME,
    SCAN,
    DriveOptions,
    Found,
    extract,
    find_layout,
    states_of,
    times_of,
    whole_episodes,
)
from numpy.typing import NDArray

from ctrl_rl_core import CtrlRlError, ScanGeometry
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import Snapshots
from koopman_lqr_controller.policies.koopman_policy import ObservationFn
from koopman_lqr_controller.sensing.lidar_mounting import yaw_of_lidar


@dataclass(frozen=True)
class TrajectorySegment:
    """A gapless segment of a recorded drive.

    Attributes:
        x: Observation of each scan (T + 1, n).
        u: Commands between consecutive scans (T, 2): speed [m/s], turn rate [rad/s].
        dt: Median time between scans [s].
    """

    x: Array
    u: Array
    dt: float

    def __len__(self) -> int:
        return len(self.u)

    @property
    def digest(self) -> str:
        """Digest of the commands, which identifies a drive independently of the policy's observation."""
        return hashlib.sha256(np.ascontiguousarray(np.round(self.u, 5) + 0.0, "<f8").tobytes()).hexdigest()[:16]

    def cut(self, begin: int, end: int) -> TrajectorySegment:
        """Select the steps from `begin` up to, but excluding, `end`."""
        return TrajectorySegment(self.x[begin : end + 1], self.u[begin:end], self.dt)


def load_segments(
    bag: Path,
    observe: ObservationFn,
    options: DriveOptions | None = None,
    lidar_yaw: float | None = None,
    tell: Tell = warn,
) -> list[TrajectorySegment]:
    """Return the observations and commands of one bag, as one segment per gapless sequence.

    If the bag has ground truth on episodes (from a simulator), samples after a collision or the goal are omitted; so
    are samples without a command or odometry within the last second.

    Args:
        bag: Bag with scans, odometry and commands (Twist or TwistStamped).
        observe: Function from a scan and odometry to an observation.
        options: Topics, beams and clock; the default ones if omitted.
        lidar_yaw: Direction of the scan's zero bearing in the robot's frame [rad]; None to use the bag's /tf_static, or
            0 without it.
        tell: Called with a line about omissions and assumptions; a warning by default.

    Raises:
        KoopmanError: The bag has no usable data.
        BagError: The bag cannot be read, a topic is missing, or two clocks differ.
    """
    how = (options or DriveOptions()).extraction(even=True)
    layout, found = find_layout(bag, how), Found()
    if layout.command.endswith("RotorThrusts"):
        raise KoopmanError(f"{bag}: its commands are thrusts: a robot on wheels is needed")
    yaw = yaw_of_lidar(bag, how.topic("scan"), how.robot, found.note) if lidar_yaw is None else lidar_yaw
    geometry = layout.scan.geometry.turned(yaw)
    out: list[TrajectorySegment] = []
    for _, columns in whole_episodes(extract([bag], layout, how, found)):
        out += _pieces(columns, observe, geometry)
    if not out:
        raise KoopmanError(f"{bag}: {found.why_nothing}")
    for line in found.notes:
        tell(line)
    return out


def to_snapshots(segments: Sequence[TrajectorySegment]) -> list[Snapshots]:
    """Return the snapshots of each drive."""
    return [Snapshots(segment.x[:-1], segment.u, segment.x[1:]) for segment in segments]


def mean_time_step(segments: Sequence[TrajectorySegment]) -> float:
    """Return the mean time step of drives [s], weighted by their length."""
    return float(np.average([segment.dt for segment in segments], weights=[len(segment) for segment in segments]))


def check_held_out(share: float) -> None:
    """Raise if a fraction cannot be held out.

    Raises:
        KoopmanError: The fraction is not in [0, 1).
    """
    if not 0.0 <= share < 1.0:
        raise KoopmanError(f"--held-out is {share}: must be at least 0 and less than 1")


def split(
    segments: Sequence[TrajectorySegment], held_out: float
) -> tuple[list[TrajectorySegment], list[TrajectorySegment]]:
    """Split drives into the data to fit, and the last fraction of all steps for evaluation.

    Args:
        segments: Segments in bag order.
        held_out: Held-out fraction of the steps, 0 <= held_out < 1.
    """
    return _cut(segments, _counts(segments, held_out))


def fitted_steps(segments: Sequence[TrajectorySegment], held_out: float) -> dict[str, int]:
    """Return the number of steps of each drive fitted by `split`, by the drive's digest, for the policy's manifest."""
    return {each.digest: count for each, count in zip(segments, _counts(segments, held_out), strict=True)}


def split_by(
    segments: Sequence[TrajectorySegment], fitted: Mapping[str, int]
) -> tuple[list[TrajectorySegment], list[TrajectorySegment]]:
    """Split drives into the parts used for fitting a policy, and the unseen parts.

    Args:
        segments: Drives.
        fitted: Number of initial steps used for the fit, by the drive's digest; 0 for other drives.
    """
    return _cut(segments, [min(fitted.get(segment.digest, 0), len(segment)) for segment in segments])


def _counts(segments: Sequence[TrajectorySegment], held_out: float) -> list[int]:
    """Return the number of initial steps of each drive used for the fit."""
    left = sum(len(segment) for segment in segments) - round(held_out * sum(len(segment) for segment in segments))
    out = []
    for segment in segments:
        out.append(min(max(left, 0), len(segment)))
        left -= out[-1]
    return out


def _cut(
    segments: Sequence[TrajectorySegment], counts: Sequence[int]
) -> tuple[list[TrajectorySegment], list[TrajectorySegment]]:
    """Split drives into their initial steps, by the given counts, and the rest."""
    seen = [segment.cut(0, here) for segment, here in zip(segments, counts, strict=True) if here]
    unseen = [segment.cut(here, len(segment)) for segment, here in zip(segments, counts, strict=True)]
    return seen, [segment for segment in unseen if len(segment)]


def _pieces(
    columns: Mapping[str, NDArray[Any]], observe: ObservationFn, geometry: ScanGeometry
) -> list[TrajectorySegment]:
    """Return the parts of an episode whose scans have measurements."""
    speeds = states_of(columns[ODOMETRY])[:, 3:].astype(np.float64)
    seen = [_seen(observe, *row, geometry) for row in zip(columns[SCAN], speeds, strict=True)]
    width = max((len(x) for x in seen if x is not None), default=0)
    if not width:  # no scan has a measurement
        return []
    x = np.array([np.full(width, np.nan) if it is None else it for it in seen])
    u = columns[ACTION][:-1]
    usable = np.isfinite(x[:-1]).all(axis=1) & np.isfinite(x[1:]).all(axis=1) & (columns[OUTCOME][:-1] == 0)
    usual = float(np.median(np.diff(times_of(columns)))) * 1e-9
    cuts = np.flatnonzero(~usable)
    runs = np.split(np.arange(len(usable)), np.unique(np.concatenate((cuts, cuts + 1))))
    return [
        TrajectorySegment(x[rows[0] : rows[-1] + 2], u[rows], usual)
        for rows in runs
        if len(rows) and usable[rows].all()
    ]


def _seen(observe: ObservationFn, ranges: NDArray[np.float32], speeds: Array, geometry: ScanGeometry) -> Array | None:
    """Return x of one sample; None if the scan has no measurement."""
    try:
        return observe(ranges, geometry, float(speeds[0]), float(speeds[1]))
    except CtrlRlError:
        return None

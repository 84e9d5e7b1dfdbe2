"""Trajectory segments from bags: a policy's observations, and the recorded commands."""

from __future__ import annotations

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
    bag: Path,
    observe: ObservationFn,
    options: DriveOptions | None = None,
    lidar_yaw: float | None = None,
    tell: Tell = warn,
) -> list[TrajectorySegment]:
    """Return what was seen and commanded in one bag, apart for each sequence without a gap.

    Where the bag holds ground truth about episodes (a simulator's), what follows a collision or the goal is left out;
    so is what has no command or odometry of the last second.

    Args:
        bag: With scans, odometry and commands (Twist or TwistStamped).
        observe: Function from a scan and odometry to an observation.
        options: Topics, beams and clock; the usual ones unless given.
        lidar_yaw: Direction of the scan's zero bearing in the robot's frame [rad]; None for what the bag's /tf_static
            says, and 0 where it says nothing.
        tell: Takes a line about what was left out or taken for granted; warns unless given.

    Raises:
        KoopmanError: the bag holds nothing usable.
        BagError: the bag cannot be read, a topic is missing, or two clocks differ.
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
    columns: Mapping[str, NDArray[Any]], observe: ObservationFn, geometry: ScanGeometry
) -> list[TrajectorySegment]:
    """Return the parts of an episode whose scans show something."""
    speeds = states_of(columns[ODOMETRY])[:, 3:].astype(np.float64)
    seen = [_seen(observe, *row, geometry) for row in zip(columns[SCAN], speeds, strict=True)]
    width = max((len(x) for x in seen if x is not None), default=0)
    if not width:  # no scan shows anything
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
    """Return x of one sample, None where the scan shows nothing."""
    try:
        return observe(ranges, geometry, float(speeds[0]), float(speeds[1]))
    except CtrlRlError:
        return None

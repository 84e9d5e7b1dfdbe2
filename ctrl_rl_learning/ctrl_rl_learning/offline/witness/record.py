"""Collects what recorded drives saw and did while they are read: scans at their poses, speeds and commands.

witness = Witness(task)
load_transitions(bags, task, witness=witness)
account = examine(witness.record(), task)
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from ctrl_rl_bags.datasets import ACTION, IS_LAST, ODOMETRY, SCAN, Frames, ScanLayout
from ctrl_rl_core.sensing import OMEGA_Z, V, measured, planar
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask

Array = NDArray[np.float64]
MOST_BEAMS = 300_000
"""Number of beams that are looked at; of longer drives every second, fourth, ... beam is, and then scan."""
_FEWEST_BEAMS = 90
"""Beams of a scan that are kept before scans are left out: poses that follow closely tell how a robot went."""
_FARTHEST = 30.0
"""Reach beyond which no lidar on a small robot is believed [m]: an LDS-02 claims 100 m."""


@dataclass(frozen=True)
class Sightings:
    """Scans of one lidar, with the poses at which they were taken.

    Attributes:
        poses: Poses of the robot x, y, theta (N, 3) [m, m, rad].
        bearings: Bearings of the beams in the robot's frame (B,) [rad].
        ranges: Ranges (N, B) [m] by `ctrl_rl_core.sensing.measured`: +inf for nothing there, NaN for no measurement.
        reach: Largest distance that the lidar measures [m].
        episodes: Number of the episode of each scan (N,).
    """

    poses: Array
    bearings: Array
    ranges: NDArray[np.float32]
    reach: float
    episodes: NDArray[np.int64]

    def rows(self, chosen: slice | NDArray[Any]) -> Sightings:
        """Return some of the scans."""
        return Sightings(self.poses[chosen], self.bearings, self.ranges[chosen], self.reach, self.episodes[chosen])


def lidar_place(task: NavigationTask) -> tuple[float, float]:
    """Return where the lidar sits, ahead of the robot's middle and to the left of it [m]."""
    robot = task.robot.robot
    return (0.0, 0.0) if robot is None else (robot.lidar.x, robot.lidar.y)


@dataclass(frozen=True)
class DriveRecord:
    """What recorded drives saw and did.

    Attributes:
        sightings: Scans, by the lidars that took them.
        speeds: Speeds ahead and turn rates by odometry (n, 2) [m/s, rad/s].
        commands: Commands (n, 2).
        episodes: Number of episodes.
    """

    sightings: tuple[Sightings, ...]
    speeds: Array
    commands: Array
    episodes: int


class Witness:
    """Collects a `DriveRecord`, an episode at a time, in bounded memory.

    Args:
        task: Task that was driven, whose robot carries the lidar.
    """

    def __init__(self, task: NavigationTask) -> None:
        robot = task.robot.robot
        self._yaw = 0.0 if robot is None else robot.lidar.yaw
        self._scans: dict[tuple[Any, ...], list[Sightings]] = {}
        self._speeds: list[Array] = []
        self._commands: list[Array] = []
        self._every, self._stride, self._beams, self._episodes = 1, 1, 0, 0

    def watch(self, frames: Iterable[Frames], scan: ScanLayout) -> Iterator[Frames]:
        """Yield frames of one layout as they come, and take what they hold."""
        for piece in frames:
            self._take(piece.columns, scan)
            self._episodes += piece.last
            yield piece

    def _take(self, columns: Mapping[str, NDArray[Any]], scan: ScanLayout) -> None:
        geometry = scan.geometry.turned(self._yaw)
        odometry = columns[ODOMETRY]
        chosen = slice(None, None, self._every)
        ranges = np.array([measured(row, geometry) for row in columns[SCAN][chosen]], dtype=np.float32)
        bearings = geometry.angle_min + geometry.angle_increment * np.arange(geometry.beams, dtype=np.float64)
        key = (geometry.beams, *bearings[[0, -1]].tolist(), min(geometry.range_max, _FARTHEST))
        seen = Sightings(
            np.array([planar(row[:7].tolist()) for row in odometry[chosen]]),
            bearings[:: self._stride],
            ranges[:, :: self._stride],
            key[-1],
            np.full(len(ranges), self._episodes),
        )
        self._scans.setdefault(key, []).append(seen)
        self._speeds.append(odometry[:, [V, OMEGA_Z]])
        self._commands.append(columns[ACTION][~columns[IS_LAST].astype(np.bool_)])
        self._beams += seen.ranges.size
        while self._beams > 2 * MOST_BEAMS:
            self._thin_out()

    def record(self) -> DriveRecord:
        """Return what was collected."""
        return DriveRecord(
            tuple(_joined(parts) for parts in self._scans.values()),
            np.concatenate([np.empty((0, 2)), *self._speeds]),
            np.concatenate([np.empty((0, 2)), *self._commands]),
            self._episodes,
        )

    def _thin_out(self) -> None:
        """Keep every second beam, or scan where the beams are few, of those to come as well."""
        of_beams = min(len(parts[0].bearings) for parts in self._scans.values()) >= 2 * _FEWEST_BEAMS
        self._stride, self._every = (2 * self._stride, self._every) if of_beams else (self._stride, 2 * self._every)
        for key, parts in self._scans.items():
            seen = _joined(parts)
            fewer = replace(seen, bearings=seen.bearings[::2], ranges=seen.ranges[:, ::2]) if of_beams else None
            self._scans[key] = [fewer or seen.rows(slice(None, None, 2))]
        self._beams = sum(part.ranges.size for parts in self._scans.values() for part in parts)


def _joined(parts: list[Sightings]) -> Sightings:
    first = parts[0]
    return Sightings(
        np.concatenate([part.poses for part in parts]),
        first.bearings,
        np.concatenate([part.ranges for part in parts]),
        first.reach,
        np.concatenate([part.episodes for part in parts]),
    )

"""What each recorded beam says about the task's walls: they are there, something is nearer, or the beam goes farther.

A range by the file is an interval here: a pose that is a little wrong gives another range, far away, at a slant or at a
corner. A beam in which a wall that stands `DIFFERENCE` from its place would not show has no vote.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from ctrl_rl_core.tasks import wrap
from numpy.typing import NDArray
from sim_bridge.engines import shape_row
from sim_bridge.fleet import scans

from ctrl_rl_core import NavigationTask, World
from ctrl_rl_learning.offline.data.motion import displaced
from ctrl_rl_learning.offline.witness.map_rays import map_ranges
from ctrl_rl_learning.offline.witness.record import Sightings, lidar_place

Array = NDArray[np.float64]
DIFFERENCE = 0.10
"""Displacement of a wall that the check must tell [m]."""
SHORTER, AGREES, LONGER, NO_VOTE = -1, 0, 1, 2
_SHIFT, _TURN = 0.02, math.radians(0.5)
"""Errors of a pose that contradict nothing [m, rad]."""
_LEAST_TOLERANCE, _NOISES, _LEAST_NOISE = 0.05, 2.0, 0.01
_EDGE = 0.3
"""Beams whose interval is longer pass an edge [m]: they tell nothing about how far a wall is from its place."""
_AT_ONCE = 200_000


@dataclass(frozen=True)
class Expected:
    """Ranges by the task's file, each (N, B) [m], +inf where nothing is in reach.

    Attributes:
        middle: Range at the recorded pose.
        low: Least range within the errors of a pose.
        high: Largest range within them.
        slopes: Change of the range with the lidar's x, y [m/m] and heading [m/rad] (N, B, 3), 0 where unknown.
    """

    middle: Array
    low: Array
    high: Array
    slopes: Array


class FileWalls:
    """The walls of a task's file as a lidar on its robot would see them.

    Args:
        task: Task of the file.
        worlds: Walls of episodes that have others, by their number.
    """

    def __init__(self, task: NavigationTask, worlds: Mapping[int, World] | None = None) -> None:
        self.task = task
        self._map = None if task.map is None else task.map.map
        self._usual = self._shapes_of(task.build_world())
        self._others = {number: self._shapes_of(world) for number, world in (worlds or {}).items()}
        self._mount = lidar_place(task)

    def _shapes_of(self, world: World) -> Array:
        shapes = world.obstacles if self._map is not None else (*world.walls, *world.obstacles)
        return np.array([shape_row(shape) for shape in shapes])

    def expect(self, seen: Sightings) -> Expected:
        """Return the ranges that the file gives where scans were taken."""
        lidars = displaced(seen.poses, np.array([(*self._mount, 0.0)]))
        middle = self._cast(lidars, seen)
        low, high, slopes = middle.copy(), middle.copy(), np.zeros((*middle.shape, 3))
        for axis, size in enumerate((_SHIFT, _SHIFT, _TURN)):
            error = np.zeros(3)
            error[axis] = size
            after, before = self._cast(lidars + error, seen), self._cast(lidars - error, seen)
            low, high = np.minimum(low, np.minimum(after, before)), np.maximum(high, np.maximum(after, before))
            known = np.isfinite(after) & np.isfinite(before)
            slopes[known, axis] = (after[known] - before[known]) / (2.0 * size)
        return Expected(middle, low, high, slopes)

    def _cast(self, lidars: Array, seen: Sightings) -> Array:
        out = np.full((len(lidars), len(seen.bearings)), np.inf)
        for shapes, rows in self._by_world(seen.episodes):
            if len(shapes):
                part = np.empty((len(lidars[rows]), len(seen.bearings)))
                scans(shapes, lidars[rows], seen.bearings, seen.reach, part)
                out[rows] = part
        return out if self._map is None else np.minimum(out, map_ranges(self._map, lidars, seen.bearings, seen.reach))

    def _by_world(self, episodes: NDArray[np.int64]) -> Iterator[tuple[Array, slice | NDArray[np.bool_]]]:
        """Yield the shapes of each world, with the scans that were taken in it."""
        if not self._others:
            yield self._usual, slice(None)
            return
        for number in np.unique(episodes).tolist():
            yield self._others.get(number, self._usual), episodes == number


@dataclass(frozen=True)
class Beams:
    """Beams with a measurement, those of many scans one after the other (M,).

    Attributes:
        starts: Places of the lidar (M, 2) [m].
        directions: Unit vectors (M, 2).
        ranges: Measured ranges [m], the lidar's reach where nothing was there.
        echoes: Whether something was there.
        expected: Ranges by the file [m], +inf for nothing.
        off: By how much the wall stands off its place, across itself [m]; +: farther; NaN where there is none.
        votes: SHORTER, AGREES, LONGER or NO_VOTE.
        scans: Number of the scan.
        episodes: Number of the episode.
    """

    starts: Array
    directions: Array
    ranges: Array
    echoes: NDArray[np.bool_]
    expected: Array
    off: Array
    votes: NDArray[np.int64]
    scans: NDArray[np.int64]
    episodes: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def ends(self) -> Array:
        """Places where the beams ended (M, 2) [m]."""
        return self.starts + self.ranges[:, None] * self.directions

    @property
    def expected_ends(self) -> Array:
        """Places where they would have ended by the file (M, 2) [m]; infinite where nowhere."""
        return self.starts + self.expected[:, None] * self.directions

    @property
    def differing(self) -> float:
        """Share of the beams that are shorter or longer than the file says."""
        return float(np.mean((self.votes == SHORTER) | (self.votes == LONGER))) if len(self) else 0.0

    def rows(self, chosen: NDArray[np.bool_]) -> Beams:
        """Return some of the beams."""
        return Beams(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})


def compare(seen: Sequence[Sightings], walls: FileWalls) -> Beams:
    """Return what each beam says about the walls of a task's file."""
    task = walls.task
    tolerance = _LEAST_TOLERANCE + _NOISES * max(_LEAST_NOISE, noise_of(task))
    parts, first = [], 0
    for sightings in seen:
        for piece in pieces(sightings):
            parts.append(_judge(piece, walls.expect(piece), task, tolerance, first))
            first += len(piece.poses)
    return Beams(
        **{field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Beams)}
    )


def noise_of(task: NavigationTask) -> float:
    """Return the largest noise of a task's lidar [m]."""
    drawn = task.randomisation.get("scan_noise")
    return task.lidar.noise if drawn is None else drawn.high


def dropout_of(task: NavigationTask) -> float:
    """Return the largest share of beams that a task's lidar loses."""
    drawn = task.randomisation.get("scan_dropout")
    return task.lidar.dropout if drawn is None else drawn.high


def pieces(seen: Sightings) -> Iterator[Sightings]:
    """Yield scans in pieces that fit the memory."""
    step = max(1, _AT_ONCE // max(1, len(seen.bearings)))
    for first in range(0, max(1, len(seen.poses)), step):
        yield seen.rows(slice(first, first + step))


def _judge(seen: Sightings, file: Expected, task: NavigationTask, tolerance: float, first: int) -> Beams:
    ranges, echoes = seen.ranges.astype(np.float64), np.isfinite(seen.ranges)
    lidars = displaced(seen.poses, np.array([(*lidar_place(task), 0.0)]))
    headings = wrap(lidars[:, 2:] + seen.bearings)
    directions = np.stack((np.cos(headings), np.sin(headings)), axis=-1)
    starts = np.broadcast_to(lidars[:, None, :2], directions.shape)
    ranges = np.where(echoes, ranges, seen.reach)
    body = np.linalg.norm(starts + ranges[..., None] * directions - seen.poses[:, None, :2], axis=-1)
    kept = ~np.isnan(seen.ranges) & (body > task.robot.radius)  # what is nearer is the robot's own body
    high = np.minimum(file.high, seen.reach)
    low = np.minimum(file.low, seen.reach)
    votes = np.where(ranges < low - tolerance, SHORTER, np.where(ranges > high + tolerance, LONGER, AGREES))
    slope = np.maximum(np.linalg.norm(file.slopes[..., :2], axis=-1), 1.0)
    unsure = np.where(np.isfinite(file.middle), np.maximum(high - file.middle, file.middle - low), 0.0)
    blind = (DIFFERENCE * slope < tolerance + unsure) | (high - low > _EDGE)
    votes[(votes == AGREES) & blind] = NO_VOTE
    off = np.where(np.isfinite(file.middle), (ranges - file.middle) / slope, np.nan)
    numbers = np.broadcast_to((first + np.arange(len(ranges)))[:, None], ranges.shape)
    episodes = np.broadcast_to(seen.episodes[:, None], ranges.shape)
    return Beams(
        starts[kept], directions[kept], ranges[kept], echoes[kept], file.middle[kept], off[kept], votes[kept],
        numbers[kept], episodes[kept],
    )  # fmt: skip

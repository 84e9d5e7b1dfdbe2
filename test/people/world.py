"""A room with people, seen by a lidar; people walk on, or stop for a robot that stands."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap, ScanGeometry
from people.encounters import Encounter, Person

Array = NDArray[np.float64]

STANDS = 0.05
"""Speed below which a robot stands [m/s]."""
_CELL, _EDGE = 0.05, 0.2
_NOISE = 0.01
_CLOSE = 0.9
"""Distance from a robot within which nobody begins to walk [m]."""


def map_of(encounter: Encounter) -> OccupancyMap:
    """Return the map of the room, without people."""
    columns, rows = (round((size + 2.0 * _EDGE) / _CELL) for size in encounter.room)
    map_ = OccupancyMap(np.zeros((rows, columns), np.int8), _CELL, (-_EDGE, -_EDGE, 0.0))
    centres = map_.cell_to_world(*np.indices((rows, columns)))
    inside = ((centres > 0.0) & (centres < encounter.room)).all(axis=-1)
    return OccupancyMap(np.where(inside, 0, 100).astype(np.int8), _CELL, map_.origin)


class Walker:
    """A person on its way.

    Attributes:
        person: The person.
        place: Its position (2,) [m].
    """

    def __init__(self, person: Person) -> None:
        self.person = person
        self._length = max(math.dist(*person.ends), 1e-9)
        self._walked = person.begin * 2.0 * self._length
        self._waits, self._at_end = person.stands, person.stands > 0.0
        self.place = self._at(self._walked)

    def _at(self, walked: float) -> Array:
        there = walked % (2.0 * self._length)
        share = min(there, 2.0 * self._length - there) / self._length
        return np.asarray(self.person.ends[0] + share * (self.person.ends[1] - self.person.ends[0]))

    def advance(self, now: float, step: float, robot: Array, speed: float, robot_radius: float) -> None:
        """Walk on for a step, unless a robot that stands is in the way."""
        if now < self._waits or (self._at_end and math.dist(self.place, robot) < _CLOSE):
            return
        walked = self._walked + step * self.person.speed
        there = self._at(walked)
        near = self.person.radius + robot_radius + self.person.gap
        comes = math.dist(there, robot) < min(near, math.dist(self.place, robot))
        if self.person.gap >= 0.0 and comes and abs(speed) < STANDS:
            return
        self._at_end = walked // self._length > self._walked // self._length
        if self._at_end:
            self._waits = now + self.person.pause
        self._walked, self.place = walked, there


def look(origin: Array, scan: ScanGeometry, yaw: float, encounter: Encounter, walkers: list[Walker]) -> Array:
    """Return the exact ranges of a scan (beams,) [m], infinite beyond the lidar's range."""
    bearings = yaw + scan.angle_min + scan.angle_increment * np.arange(scan.beams)
    rays = np.column_stack((np.cos(bearings), np.sin(bearings)))
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = (np.where(rays > 0.0, encounter.room, 0.0) - origin) / rays
        ranges = np.where(np.isfinite(walls), walls, np.inf).min(axis=1)
    for walker in walkers:
        to = walker.place - origin
        along = rays @ to
        inside = walker.person.radius**2 - (to @ to - along**2)
        near = along - np.sqrt(np.maximum(inside, 0.0))
        ranges = np.where((inside > 0.0) & (near > 0.0), np.minimum(ranges, near), ranges)
    return np.where(ranges > scan.range_max, np.inf, ranges)


def measure(ranges: Array, random: np.random.Generator, lost: float) -> NDArray[np.float32]:
    """Return ranges with the noise of a lidar that loses some beams."""
    noisy = ranges + _NOISE * random.standard_normal(len(ranges))
    return np.where(random.random(len(ranges)) < lost, np.inf, noisy).astype(np.float32)

"""Resampling of any laser scan to distances at fixed bearings.

Real scans vary: 360 beams of an LDS-01 with zeros for misses, 268 to 274 NaN-filled ones of an LDS-02, 720 of a
TurtleBot 4 with a third of them infinite. A policy sees none of that: it sees one distance for each bearing.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.sensing.scan import ScanError, ScanGeometry, measured, nearest_beams

Array = NDArray[np.float64]

OPENING = 1e-3
"""Scans whose openings differ by less are taken for alike [rad]: no lidar turns as evenly as that."""
EDGE = 1e-3
"""Beams on a sector's edge belong to it on both sides of the robot, whatever rounding says [rad]."""
_TURN = 2.0 * np.pi
_KNOWN = 512
"""Geometries that are kept in mind: an LDS-01 has one, an LDS-02, whose motor's speed varies, some two hundred."""
_KNOWN_BYTES = 16_000_000
"""Memory that they may take; the one used longest ago goes first."""
_RING = 1.5
"""Sectors farther apart than this many of the usual gap are no neighbours."""
# Arrays, as NumPy takes a Python number or its own scalars in twice the time.
_ONE = np.array(1)
_HALVES = np.array((0.5, 0.5))

_Key = tuple[int, float, int]
"""Number of beams, bearing of the first [rad], opening in units of `OPENING`."""


class _Beams(NamedTuple):
    """Places of the sectors' beams in `_measured` for one geometry.

    Attributes:
        places: (sectors, most beams in one + 1); each row is filled up with the NaN at the end, at least once.
        begins: Twice where each row begins, less one, and itself (2, sectors). (count + begins) / 2 are the two middle
            ones of a row's `count` smallest; of none, the first is the NaN that ends the row before.
    """

    places: NDArray[np.intp]
    begins: NDArray[np.intp]


class _Geometries:
    """The geometries that were used last, bounded in number and in memory."""

    def __init__(self) -> None:
        self._found: OrderedDict[_Key, _Beams] = OrderedDict()
        self.bytes = 0

    def __len__(self) -> int:
        return len(self._found)

    def get(self, key: _Key) -> _Beams | None:
        """Return what is known of a geometry, None for nothing."""
        found = self._found.get(key)
        if found is not None:
            self._found.move_to_end(key)
        return found

    def put(self, key: _Key, beams: _Beams) -> None:
        """Add a geometry; those used longest ago make room."""
        self._found[key] = beams
        self.bytes += beams.places.nbytes
        while len(self._found) > _KNOWN or (self.bytes > _KNOWN_BYTES and len(self._found) > 1):
            self.bytes -= self._found.popitem(last=False)[1].places.nbytes


@dataclass(frozen=True)
class Sectors:
    """The fixed bearings that a policy sees.

    Attributes:
        bearings: Middle of each sector, in order around the robot [rad].
        half_width: Half the opening of a sector [rad]; 0 for the nearest beam alone.
        far: Distance that stands for "nothing there", and cap of all others [m].
        reduce: Distance that stands for the beams of a sector: their median, or the least of them.
    """

    bearings: tuple[float, ...]
    half_width: float
    far: float
    reduce: Literal["median", "least"] = "median"

    def distances(self, ranges: NDArray[np.float32], scan: ScanGeometry) -> Array:
        """Return one distance for each sector (sectors,) [m].

        `measured` says what a beam means. Beams without a measurement do not count. Where no beam lies in a sector, the
        nearest one counts, if the lidar looks there at all. A sector without any takes the mean of its two neighbours,
        the first and the last of a fan take their only one, and `far` stands where these have none.

        Args:
            ranges: Distances of the scan's beams (scan.beams,) [m].
            scan: The scan's geometry.

        Raises:
            ScanError: The scan holds no measurement, or its geometry is none.
        """
        scan.check()
        if len(ranges) != scan.beams:
            raise ScanError(f"scan with {len(ranges)} ranges of {scan.beams}")
        beams = self._beams(scan)
        values = np.empty(scan.beams + 1)
        measured(ranges, scan, values[:-1], self.far)
        values[-1] = np.nan
        values = values.take(beams.places)
        values.sort(axis=1)  # NaN last
        if self.reduce == "least":
            return self._filled(np.minimum(values[:, 0], self._far))
        counts = values.argmax(axis=1)  # where the first NaN is
        middle = values.take((counts + beams.begins) >> _ONE)
        return self._filled(_HALVES.dot(np.minimum(middle, self._far)))

    def unseen(self, scan: ScanGeometry) -> Array:
        """Return the bearings in which the lidar does not look (n,) [rad]."""
        key = (scan.beams, scan.angle_min, round(scan.angle_increment * scan.beams / OPENING))
        found = self._unseen.get(key)
        if found is None:
            field, _ = nearest_beams(scan, self._middles)
            found = self._middles[~field]
            if len(self._unseen) >= _KNOWN:
                self._unseen.clear()
            self._unseen[key] = found
        return found

    @cached_property
    def _middles(self) -> Array:
        return np.array(self.bearings)

    @cached_property
    def _far(self) -> Array:
        return np.array(self.far)

    @cached_property
    def _known(self) -> _Geometries:
        return _Geometries()

    @cached_property
    def _unseen(self) -> dict[_Key, Array]:
        return {}

    @cached_property
    def _apart(self) -> NDArray[np.bool_]:
        """Whether a wide gap, into which the fan opens, lies between each sector and the one after it (sectors,)."""
        gaps = np.mod(np.roll(self._middles, -1) - self._middles, _TURN)
        gaps = np.minimum(gaps, _TURN - gaps)
        return np.asarray(gaps > _RING * np.median(gaps))

    def _beams(self, scan: ScanGeometry) -> _Beams:
        opening = scan.angle_increment * scan.beams
        key = (scan.beams, scan.angle_min, round(opening / OPENING))
        found = self._known.get(key)
        if found is None:
            places = self._places(scan, *key)
            twice = 2 * places.shape[1] * np.arange(len(places))
            found = _Beams(places, np.array((twice - 1, twice)))
            self._known.put(key, found)
        return found

    def _places(self, scan: ScanGeometry, beams: int, angle_min: float, opening: int) -> NDArray[np.intp]:
        """Return `_Beams.places` for an opening in units of `OPENING`.

        Beams come at equal angles, so that those of a sector follow each other, at most once over the end of the scan.
        What a scan of more than a turn sees twice is looked at once.
        """
        increment = opening * OPENING / beams
        half, turn = self.half_width + EDGE, _TURN / abs(increment)
        edge = half if increment > 0.0 else -half
        begin = (self._middles - (angle_min + edge)) / increment % turn  # in beams, from the first
        width = 2.0 * half / abs(increment)
        end = begin + width
        first = np.ceil(begin)
        to_end = np.maximum(np.minimum(np.floor(end), beams - 1) - first + 1, 0.0)
        over_end = np.minimum(np.maximum(np.floor(end - turn) + 1, 0.0), beams - to_end)
        first *= to_end > 0.0
        most = int(min(width, beams)) + 1
        count = np.minimum(to_end + over_end, most)
        field, nearest = nearest_beams(scan, self._middles)
        lone = field & (count == 0.0)
        first[lone], count[lone] = nearest[lone], 1.0
        column = np.arange(most + 1)
        places = (first.astype(np.intp)[:, None] + column) % beams
        places[column >= count[:, None]] = beams
        return places

    def _filled(self, distances: Array) -> Array:
        """Return the distances with those of empty sectors, which are NaN.

        Raises:
            ScanError: All are empty.
        """
        if not math.isnan(distances.dot(distances)):
            return distances
        empty = np.isnan(distances)
        if empty.all():
            raise ScanError("scan without any measurement")
        before, after = np.roll(distances, 1), np.roll(distances, -1)
        last = self._apart
        first = np.roll(last, 1)
        before, after = np.where(first, after, before), np.where(last, before, after)
        distances = np.where(empty, 0.5 * (before + after), distances)
        return np.where(np.isnan(distances), self.far, distances)

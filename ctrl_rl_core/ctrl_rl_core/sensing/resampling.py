"""Resamples any laser scan to distances at fixed bearings.

Real scans vary: an LDS-01 has 360 beams with zeros for misses, an LDS-02 268 to 274 NaN-filled ones, a TurtleBot 4 720
of which a third are infinite. A policy instead receives one distance per bearing.
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
"""Difference in beam spacing below which two scans count as equal [rad], since motor speeds vary more than this."""
EDGE = 1e-3
"""Tolerance for beams on a sector's edge [rad], which belong to the sector on both sides of the robot."""
_TURN = 2.0 * np.pi
_KNOWN = 512
"""Number of cached geometries: an LDS-01 has one; an LDS-02, with its varying motor speed, some two hundred."""
_KNOWN_BYTES = 16_000_000
"""Memory limit of the cached geometries [bytes]; the least recently used one is dropped first."""
_RING = 1.5
"""Sectors farther apart than this multiple of the usual gap are not neighbours."""
# Arrays, because NumPy takes twice as long with a Python number or its own scalars.
_ONE = np.array(1)
_HALVES = np.array((0.5, 0.5))

_Key = tuple[int, float, int]
"""Number of beams, bearing of the first [rad], beam spacing in units of `OPENING`."""


class _Beams(NamedTuple):
    """Indices of the sectors' beams in `_measured` for one geometry.

    Attributes:
        places: Beam indices per sector (sectors, maximum beams per sector + 1); each row is padded with the index of
            the NaN at the end, at least once.
        begins: Start offset of each row, less one, and again itself (2, sectors). (count + begins) / 2 are the two
            middle elements of a row's `count` smallest; if there are none, the first is the NaN that ends the previous
            row.
    """

    places: NDArray[np.intp]
    begins: NDArray[np.intp]


class _Geometries:
    """Cache of the most recently used geometries, bounded in number and memory."""

    def __init__(self) -> None:
        self._found: OrderedDict[_Key, _Beams] = OrderedDict()
        self.bytes = 0

    def __len__(self) -> int:
        return len(self._found)

    def get(self, key: _Key) -> _Beams | None:
        """Return the cached data of a geometry, or None."""
        found = self._found.get(key)
        if found is not None:
            self._found.move_to_end(key)
        return found

    def put(self, key: _Key, beams: _Beams) -> None:
        """Add a geometry, evicting the least recently used ones."""
        self._found[key] = beams
        self.bytes += beams.places.nbytes
        while len(self._found) > _KNOWN or (self.bytes > _KNOWN_BYTES and len(self._found) > 1):
            self.bytes -= self._found.popitem(last=False)[1].places.nbytes


@dataclass(frozen=True)
class Sectors:
    """Fixed bearings at which a policy observes distances.

    Attributes:
        bearings: Centre of each sector, in order around the robot [rad].
        half_width: Half the width of a sector [rad]; 0 for the nearest beam only.
        far: Distance that represents "no echo", and upper bound of all others [m].
        reduce: Reduction over a sector's beams: median or minimum.
    """

    bearings: tuple[float, ...]
    half_width: float
    far: float
    reduce: Literal["median", "least"] = "median"

    def distances(self, ranges: NDArray[np.float32], scan: ScanGeometry) -> Array:
        """Return one distance per sector (sectors,) [m].

        `measured` defines the meaning of each beam; beams without a measurement are ignored. If no beam lies in a
        sector, the nearest one is used, provided that the lidar covers that direction. A sector without any beam takes
        the mean of its two neighbours, and the first and last sector of a fan take their only neighbour; `far` is used
        if these are missing too.

        Args:
            ranges: Ranges of the scan's beams (scan.beams,) [m].
            scan: Geometry of the scan.

        Raises:
            ScanError: The scan has no measurement, or its geometry is invalid.
        """
        scan.check()
        if len(ranges) != scan.beams:
            raise ScanError(f"scan with {len(ranges)} ranges of {scan.beams}")
        beams = self._beams(scan)
        values = np.empty(scan.beams + 1)
        measured(ranges, scan, values[:-1], self.far)
        values[-1] = np.nan
        values = values.take(beams.places)
        values.sort(axis=1)  # NaN is sorted last
        if self.reduce == "least":
            return self._filled(np.minimum(values[:, 0], self._far))
        counts = values.argmax(axis=1)  # index of the first NaN
        middle = values.take((counts + beams.begins) >> _ONE)
        return self._filled(_HALVES.dot(np.minimum(middle, self._far)))

    def unseen(self, scan: ScanGeometry) -> Array:
        """Return the bearings that the lidar does not cover (n,) [rad]."""
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
        """Whether each sector is separated from the next by the open side of the fan (sectors,)."""
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

        Beams are evenly spaced, so those of a sector are consecutive and wrap around the end of the scan at most once.
        Directions covered twice by a scan of more than one turn are used once.
        """
        increment = opening * OPENING / beams
        half, turn = self.half_width + EDGE, _TURN / abs(increment)
        edge = half if increment > 0.0 else -half
        begin = (self._middles - (angle_min + edge)) / increment % turn  # in beams, relative to the first
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
        """Fill in the distances of empty sectors, which are NaN.

        Raises:
            ScanError: All sectors are empty.
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

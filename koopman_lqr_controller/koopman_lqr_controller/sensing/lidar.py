"""Resampling of any laser scan to distances at fixed bearings.

Real scans vary: 360 beams of an LDS-01 with zeros for misses, 268 to 274 NaN-filled ones of an LDS-02, 720 of a
TurtleBot 4 with a third of them infinite. A policy sees none of that: it sees one distance per sector.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.driving.scan import MOST_BEAMS
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry as ScanGeometry
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError

OPENING = 1e-3
"""Scans whose openings differ by less are taken for alike [rad]: no lidar turns as evenly as that."""
EDGE = 1e-3
"""Beams on a sector's edge belong to it on both sides of the robot, whatever rounding says [rad]."""
STEP_TOLERANCE = 0.25
"""Part by which a step from scan to scan may be shorter or longer than another and still count as the same."""
_TURN = 2.0 * np.pi
_KNOWN = 512
"""Geometries that are kept in mind: an LDS-01 has one, an LDS-02, whose motor's speed varies, some two hundred."""
_KNOWN_BYTES = 16_000_000
"""Memory that they may take; the one used longest ago goes first."""
# Arrays, as NumPy takes a Python number or its own scalars in twice the time.
_ONE = np.array(1)
_HALVES = np.array((0.5, 0.5))
_MISS, _NOTHING, _TOO_CLOSE, _UNKNOWN = np.array(0.0), np.array(np.inf), np.array(-np.inf), np.array(np.nan)


def check_speeds(v: float, omega: float) -> None:
    """Refuse the odometry that a scan is seen with.

    Raises:
        KoopmanError: speed or turn rate are not finite.
    """
    if not (math.isfinite(v) and math.isfinite(omega)):
        raise KoopmanError(f"odometry with speed {v} and turn rate {omega}")


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
        half_width: Half the opening of a sector [rad].
        far: Distance that stands for "nothing there", and cap of all others [m].
    """

    bearings: tuple[float, ...]
    half_width: float
    far: float

    def distances(self, ranges: NDArray[np.float32], scan: ScanGeometry) -> Array:
        """Return one distance for each sector: the median of its beams (sectors,) [m].

        A beam counts by REP-117: +inf, 0 (LDS-01's miss) and beyond range_max mean nothing there: `far`; -inf means
        too close: range_min; NaN and 0 < r < range_min are no measurement. A sector without measurement takes the
        mean of its two neighbours, and `far` where these have none either.

        Args:
            ranges: Distances of the scan's beams (scan.beams,) [m].
            scan: The scan's geometry.

        Raises:
            KoopmanError: the scan holds no measurement, or its geometry is none.
        """
        if len(ranges) != scan.beams or scan.beams == 0 or not 0.0 <= scan.range_min < scan.range_max:
            raise KoopmanError(
                f"scan with {len(ranges)} ranges of {scan.beams} in {scan.range_min} .. {scan.range_max} m"
            )
        beams = self._beams(scan)
        values = _measured(ranges, scan.range_min).take(beams.places)
        values.sort(axis=1)  # NaN last
        counts = values.argmax(axis=1)  # where the first NaN is
        middle = values.take((counts + beams.begins) >> _ONE)
        if scan.range_max < self.far:
            middle[middle > scan.range_max] = self.far
        return self._filled(_HALVES.dot(np.minimum(middle, self._far)))

    @cached_property
    def _middles(self) -> Array:
        return np.array(self.bearings)

    @cached_property
    def _far(self) -> Array:
        return np.array(self.far)

    @cached_property
    def _known(self) -> _Geometries:
        return _Geometries()

    def _beams(self, scan: ScanGeometry) -> _Beams:
        if scan.beams > MOST_BEAMS:
            raise KoopmanError(f"scan with {scan.beams} ranges: must be 1 to {MOST_BEAMS}")
        opening = scan.angle_increment * scan.beams
        if not (math.isfinite(scan.angle_min) and math.isfinite(opening) and abs(opening) > OPENING):
            raise KoopmanError(f"scan with angle_increment {scan.angle_increment} and angle_min {scan.angle_min}")
        key = (scan.beams, scan.angle_min, round(opening / OPENING))
        found = self._known.get(key)
        if found is None:
            places = self._places(*key)
            twice = 2 * places.shape[1] * np.arange(len(places))
            found = _Beams(places, np.array((twice - 1, twice)))
            self._known.put(key, found)
        return found

    def _places(self, beams: int, angle_min: float, opening: int) -> NDArray[np.intp]:
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
        column = np.arange(most + 1)
        places = (first.astype(np.intp)[:, None] + column) % beams
        places[column >= count[:, None]] = beams
        return places

    def _filled(self, distances: Array) -> Array:
        """Return the distances with those of empty sectors, which are NaN.

        Raises:
            KoopmanError: all are empty.
        """
        if not math.isnan(distances.dot(distances)):
            return distances
        empty = np.isnan(distances)
        if empty.all():
            raise KoopmanError("scan without any measurement")
        both = np.roll(distances, 1) + np.roll(distances, -1)
        distances = np.where(empty, 0.5 * both, distances)
        return np.where(np.isnan(distances), self.far, distances)


def _measured(ranges: NDArray[np.float32], range_min: float) -> Array:
    """Return each beam's distance [m], infinite where nothing is there, NaN where nothing was measured; last a NaN.

    The shape is (beams + 1,).
    """
    out = np.empty(len(ranges) + 1)
    out[:-1], out[-1] = ranges, np.nan
    np.putmask(out, out == _MISS, _NOTHING)
    np.putmask(out, out == _TOO_CLOSE, range_min)
    np.putmask(out, out < range_min, _UNKNOWN)
    return out

"""Any laser scan to distances at fixed bearings.

Real scans vary: 360 beams of an LDS-01 with zeros for misses, 268 to 274 NaN-filled ones of an LDS-02, 720 of a
TurtleBot 4 with a third of them infinite. A policy sees none of that: it sees one distance per sector.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.errors import KoopmanError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScanGeometry:
    """Where the beams of a scan point and what they can measure, as sensor_msgs/LaserScan says it.

    Attributes:
        beams: number of ranges.
        angle_min: bearing of the first beam in the robot's frame, counter-clockwise from ahead [rad].
        angle_increment: from beam to beam [rad].
        range_min: least distance measured [m].
        range_max: largest distance measured [m].
    """

    beams: int
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float


@dataclass(frozen=True)
class Sectors:
    """The fixed bearings that a policy sees.

    Attributes:
        bearings: middle of each sector, in order around the robot [rad].
        half_width: half the opening of a sector [rad].
        far: distance that stands for "nothing there", and cap of all others [m].
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
            ranges: (scan.beams,) [m].
            scan: the scan's geometry.

        Raises:
            KoopmanError: the scan holds no measurement, or its geometry is none.
        """
        if len(ranges) != scan.beams or scan.beams == 0 or not 0.0 <= scan.range_min < scan.range_max:
            raise KoopmanError(
                f"scan with {len(ranges)} ranges of {scan.beams} in {scan.range_min} .. {scan.range_max} m"
            )
        index = _sector_index(self, scan.beams, scan.angle_min, scan.angle_increment)
        measured = _measured(ranges, scan, self.far)
        values = np.append(measured, np.nan)[index]
        counts = np.count_nonzero(~np.isnan(values), axis=1)
        if not counts.any():
            raise KoopmanError("scan without any measurement")
        values.sort(axis=1)  # NaN last
        row, middle = np.arange(len(values)), np.maximum(counts - 1, 0) // 2
        out = 0.5 * (values[row, middle] + values[row, np.minimum(counts // 2, np.maximum(counts - 1, 0))])
        return self._filled(out, counts)

    def _filled(self, distances: Array, counts: NDArray[np.intp]) -> Array:
        empty = counts == 0
        if empty.any():
            both = np.roll(distances, 1) + np.roll(distances, -1)
            distances = np.where(empty, 0.5 * both, distances)
            distances = np.where(np.isnan(distances), self.far, distances)
        return distances


def _measured(ranges: NDArray[np.float32], scan: ScanGeometry, far: float) -> Array:
    """Return each beam's distance, `far` where nothing is there and NaN where nothing was measured (beams,) [m]."""
    out = ranges.astype(np.float64)
    out[(out == 0.0) | (out > scan.range_max)] = far
    out[out == -np.inf] = scan.range_min
    out[out < scan.range_min] = np.nan
    return np.minimum(out, far)


@lru_cache(maxsize=64)
def _sector_index(sectors: Sectors, beams: int, angle_min: float, angle_increment: float) -> NDArray[np.intp]:
    """Return for each sector the indices of its beams, padded with `beams` (sectors, most beams in one).

    Raises:
        KoopmanError: the increment is zero or not finite.
    """
    if not (np.isfinite(angle_min) and np.isfinite(angle_increment) and angle_increment != 0.0):
        raise KoopmanError(f"scan with angle_increment {angle_increment} and angle_min {angle_min}")
    angles = angle_min + np.arange(beams) * angle_increment
    apart = np.abs((angles - np.array(sectors.bearings)[:, None] + np.pi) % (2 * np.pi) - np.pi)
    # Beams on a sector's edge belong to it on both sides of the robot, whatever rounding says.
    inside = [np.flatnonzero(row <= sectors.half_width + 1e-6) for row in apart]
    out = np.full((len(inside), max(1, *(len(row) for row in inside))), beams)
    for row, indices in zip(out, inside, strict=True):
        row[: len(indices)] = indices
    return out

"""The content of a laser scan: echoes as points, and the directions that have any.

By REP-117 a range within range_min .. range_max is an echo, +inf nothing there, -inf something too close, NaN no
measurement; an LDS-01 writes 0 for a miss. The meaning of a single beam without an echo is up to the policy; many of
them side by side leave the space there unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.errors import CtrlRlError

MOST_BEAMS = 20_000
"""No lidar of one plane has more; a scan of a million would stop the node that looks at it for seconds."""
DIRECTIONS = 360
"""Directions around the robot in which a scan is asked for echoes."""
_TURN = 2.0 * math.pi
_BEARINGS = np.arange(DIRECTIONS, dtype=np.float64) * (_TURN / DIRECTIONS)


class ScanError(CtrlRlError):
    """An unusable scan; the message is the reason."""


@dataclass(frozen=True)
class ScanGeometry:
    """Bearings and limits of a scan's beams, as in sensor_msgs/LaserScan.

    Attributes:
        beams: Number of ranges.
        angle_min: Bearing of the first beam in the robot's frame, counter-clockwise from ahead [rad].
        angle_increment: Angle from beam to beam [rad].
        range_min: Least distance measured [m].
        range_max: Largest distance measured [m].
    """

    beams: int
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float

    def check(self) -> None:
        """Refuse a geometry that no lidar has.

        Raises:
            ScanError: No beams, too many, or numbers that are not finite or contradict each other.
        """
        if not 0 < self.beams <= MOST_BEAMS:
            raise ScanError(f"scan with {self.beams} ranges: must be 1 to {MOST_BEAMS}")
        if not (0.0 <= self.range_min < self.range_max and math.isfinite(self.range_min)):
            raise ScanError(f"scan with {self.beams} ranges in {self.range_min} .. {self.range_max} m")
        if not (abs(self.angle_min) <= 4.0 * _TURN and 1e-6 < abs(self.angle_increment) <= _TURN):
            raise ScanError(f"scan with angle_increment {self.angle_increment} and angle_min {self.angle_min}")


class ScanView(NamedTuple):
    """Echoes of one scan, as the checks of a drive need them.

    Attributes:
        share: Part of the beams that have an echo, 0 to 1.
        points: Places of the echoes within reach in the robot's frame (n, 2) [m].
        seen: Whether the beam nearest to each direction has an echo, counter-clockwise from ahead (DIRECTIONS,).
        field: Whether there is a beam in each direction at all (DIRECTIONS,).
    """

    share: float
    points: NDArray[np.float64]
    seen: NDArray[np.bool_]
    field: NDArray[np.bool_]


def view_scan(ranges: NDArray[np.float32], scan: ScanGeometry, reach: float, forward: float = 0.0) -> ScanView:
    """Return the echoes of a scan.

    Args:
        ranges: Ranges (scan.beams,) [m].
        scan: Bearings and limits of the beams.
        reach: Distance from the lidar beyond which echoes are left out [m].
        forward: Position of the lidar ahead of the robot's middle [m].

    Raises:
        ScanError: The geometry is impossible, or there is another number of ranges.
    """
    scan.check()
    if len(ranges) != scan.beams:
        raise ScanError(f"scan with {len(ranges)} ranges of {scan.beams}")
    echo = (ranges >= max(scan.range_min, 1e-6)) & (ranges <= scan.range_max) & (ranges < np.inf)
    close = ranges == -np.inf
    echo |= close
    near = np.flatnonzero(echo & (ranges < reach))
    bearings = scan.angle_min + scan.angle_increment * near
    distances = np.maximum(ranges[near], scan.range_min).astype(
        np.float64
    )  # what is too close is at the least distance
    points = np.empty((len(near), 2))
    points[:, 0], points[:, 1] = forward + distances * np.cos(bearings), distances * np.sin(bearings)
    field, nearest = nearest_beams(scan, _BEARINGS)
    return ScanView(float(np.count_nonzero(echo)) / scan.beams, points, field & echo[nearest], field)


def nearest_beams(scan: ScanGeometry, bearings: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Return whether each of some bearings (n,) [rad] has a beam (n,), and the one that is nearest to it (n,)."""
    step = abs(scan.angle_increment)
    first = scan.angle_min if scan.angle_increment > 0.0 else scan.angle_min + scan.angle_increment * (scan.beams - 1)
    half = max(0.5 * step, math.pi / DIRECTIONS)
    offset = (bearings - first + 0.5 * step) % _TURN - 0.5 * step
    after_last, before_first = offset - step * (scan.beams - 1), _TURN - offset
    field = np.minimum(after_last, before_first) <= half
    beam = np.minimum(np.rint(offset / step).astype(np.intp), scan.beams - 1)
    beam[before_first < after_last] = 0
    return field, beam if scan.angle_increment > 0.0 else scan.beams - 1 - beam

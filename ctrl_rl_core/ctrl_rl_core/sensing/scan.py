"""Laser scans: meaning of the ranges, checks of the geometry, and directions with echoes.

Live nodes, the pre-flight check and all bag readers share this definition. By REP-117, a range within
range_min .. range_max is an echo, +inf means no echo, -inf too close, and NaN no measurement; `measured` covers the
other values. The table for users is in docs/sensing.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.sensing.odometry import OMEGA_Z, V

Array = NDArray[np.float64]

MOST_BEAMS = 20_000
"""Maximum number of beams of a planar lidar; a scan of a million would block its node for seconds."""
DIRECTIONS = 360
"""Number of directions around the robot that are checked for echoes."""
_TURN = 2.0 * math.pi
_BEARINGS = np.arange(DIRECTIONS, dtype=np.float64) * (_TURN / DIRECTIONS)
_WIDEST = 1.1 * _TURN
"""Maximum angle covered by one turn of beams [rad]; angles in degrees would exceed it 57-fold."""
_FEW, _SOME = 2, 0.02
"""Allowed difference between a scan's beam count and its angles, absolute and relative: motor speeds vary."""
_SMALLEST = 1e-6
"""Ranges up to this count as zero, regardless of range_min [m]."""
# Arrays, because NumPy takes twice as long with a Python number or its own scalars.
_MISS, _TOO_CLOSE = np.array(0.0, np.float32), np.array(-np.inf, np.float32)
_NOTHING, _UNKNOWN = np.array(np.inf), np.array(np.nan)


class ScanError(CtrlRlError):
    """A scan is unusable; the message gives the reason."""


@dataclass(frozen=True)
class ScanGeometry:
    """Bearings and limits of a scan's beams, as in sensor_msgs/LaserScan.

    Attributes:
        beams: Number of ranges.
        angle_min: Bearing of the first beam in the robot's frame, counter-clockwise from ahead [rad].
        angle_increment: Angle between beams [rad].
        range_min: Minimum measured distance [m].
        range_max: Maximum measured distance [m].
        angle_max: Bearing of the last beam as stated by the message [rad]; None if not stated.
    """

    beams: int
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    angle_max: float | None = None

    @classmethod
    def of(cls, message: Any) -> ScanGeometry:
        """Return the geometry of a sensor_msgs/LaserScan, from rclpy or a bag, without checking it."""
        return cls(
            len(message.ranges),
            float(message.angle_min),
            float(message.angle_increment),
            float(message.range_min),
            float(message.range_max),
            float(message.angle_max),
        )

    def turned(self, yaw: float) -> ScanGeometry:
        """Return the geometry in a frame where this geometry's zero bearing is at `yaw` [rad]."""
        if yaw == 0.0:
            return self
        claimed = None if self.angle_max is None else self.angle_max + yaw
        return replace(self, angle_min=self.angle_min + yaw, angle_max=claimed)

    def check(self) -> None:
        """Raise if the geometry is impossible for a lidar.

        Raises:
            ScanError: There are no or too many beams, or numbers are not finite or contradict each other, which would
                place the echoes in wrong, e.g. mirrored, directions.
        """
        if not 0 < self.beams <= MOST_BEAMS:
            raise ScanError(f"scan with {self.beams} ranges: must be 1 to {MOST_BEAMS}")
        if not (0.0 <= self.range_min < self.range_max and math.isfinite(self.range_min)):
            raise ScanError(f"scan with {self.beams} ranges in {self.range_min} .. {self.range_max} m")
        if not (abs(self.angle_min) <= 4.0 * _TURN and 1e-6 < abs(self.angle_increment) <= _TURN):
            raise ScanError(f"scan with angle_increment {self.angle_increment} and angle_min {self.angle_min}")
        field = abs(self.angle_increment) * (self.beams - 1)
        if field > _WIDEST:
            raise ScanError(
                f"scan with {self.beams} ranges over {math.degrees(field):.0f} deg: its angle_increment of "
                f"{self.angle_increment:.4g} rad is wrong; is it in degrees, or that of another count of beams?"
            )
        if self.angle_max is None:
            return
        wanted = 1.0 + (self.angle_max - self.angle_min) / self.angle_increment
        if not abs(self.beams - wanted) <= _FEW + _SOME * self.beams:
            raise ScanError(
                f"the scan has {self.beams} ranges, and {wanted:.0f} by its angle_min, _max and _increment: "
                "its echoes would appear in wrong directions"
            )


class Scan(NamedTuple):
    """One scan.

    Attributes:
        ranges: Ranges of the beams (beams,) [m].
        geometry: Bearings and limits of the beams.
    """

    ranges: NDArray[np.float32]
    geometry: ScanGeometry


class Sensors(NamedTuple):
    """Sensor readings at the time of a scan, from a live node, a simulator or a bag.

    Attributes:
        ranges: Ranges of the scan's beams (beams,) [m].
        scan: Bearings and limits of the beams in the robot's frame.
        odometry: Latest odometry (13,), see `ODOMETRY_NAMES`.
        pose: Pose x, y, theta (3,) [m, m, rad]; None if unknown.
        goal: Goal x, y, theta in the frame of the pose (3,) [m, m, rad]; None without a goal.
        command: Last command sent (2,).
        time: Time of the odometry, on the robot's clock [s].
        age: Age of the scan at that time [s]; 0 for a scan taken at that time.
    """

    ranges: NDArray[np.float32]
    scan: ScanGeometry
    odometry: Array
    pose: Array | None
    goal: Array | None
    command: Array
    time: float = 0.0
    age: float = 0.0

    @property
    def speeds(self) -> tuple[float, float]:
        """Forward speed [m/s] and turn rate [rad/s] from odometry of a wheeled robot."""
        return float(self.odometry[V]), float(self.odometry[OMEGA_Z])


def read_scan(message: Any, yaw: float = 0.0) -> Scan:
    """Return ranges and geometry of a sensor_msgs/LaserScan, unchecked; see `ScanGeometry.check`.

    Args:
        message: Scan from rclpy or a bag.
        yaw: Direction of the scan's zero bearing in the robot's frame [rad].
    """
    return Scan(np.asarray(message.ranges, dtype=np.float32), ScanGeometry.of(message).turned(yaw))


def measured(
    ranges: NDArray[np.float32], scan: ScanGeometry, out: Array | None = None, farthest: float = math.inf
) -> Array:
    """Return the meaning of each beam (beams,) [m]: a distance, +inf for no echo, NaN for no measurement.

    +inf, 0 (a miss of an LDS-01) and values above range_max mean no echo; -inf means an object closer than range_min,
    set to range_min; NaN, values below range_min and negative values are no measurement.

    Args:
        ranges: Ranges of the beams (beams,) [m].
        scan: Bearings and limits of the beams.
        out: Output array (beams,).
        farthest: Distance beyond which the caller does not distinguish an echo from none [m].
    """
    if out is None:
        out = np.empty(len(ranges))
    out[...] = ranges
    np.putmask(out, ranges < np.array(max(scan.range_min, _SMALLEST), np.float32), _UNKNOWN)
    if scan.range_max < farthest:
        np.putmask(out, ranges > np.array(scan.range_max, np.float32), _NOTHING)
    np.putmask(out, ranges == _MISS, _NOTHING)
    np.putmask(out, ranges == _TOO_CLOSE, scan.range_min)
    return out


def echoes(ranges: NDArray[np.float32], scan: ScanGeometry, reach: float, forward: float = 0.0) -> Array:
    """Return the positions of the echoes in the robot's frame (n, 2) [m].

    Args:
        ranges: Ranges of the beams (beams,) [m].
        scan: Bearings and limits of the beams in the robot's frame.
        reach: Distance from the lidar beyond which echoes are omitted [m].
        forward: Position of the lidar ahead of the robot's centre [m].
    """
    return _points(measured(ranges, scan), scan, reach, forward)


def _points(distances: Array, scan: ScanGeometry, reach: float, forward: float) -> Array:
    near = np.flatnonzero((distances < reach) & (distances < np.inf))
    bearings, far = scan.angle_min + scan.angle_increment * near, distances[near]
    points = np.empty((len(near), 2))
    points[:, 0], points[:, 1] = forward + far * np.cos(bearings), far * np.sin(bearings)
    return points


class ScanView(NamedTuple):
    """Echoes of one scan, as needed by safety checks.

    Attributes:
        share: Fraction of the beams with an echo, 0 to 1.
        points: Positions of the echoes within reach in the robot's frame (n, 2) [m].
        seen: Whether the beam nearest to each direction has an echo, counter-clockwise from ahead (DIRECTIONS,).
        field: Whether each direction is covered by a beam (DIRECTIONS,).
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
        reach: Distance from the lidar beyond which echoes are omitted [m].
        forward: Position of the lidar ahead of the robot's centre [m].

    Raises:
        ScanError: The geometry is impossible, or the number of ranges does not match it.
    """
    scan.check()
    if len(ranges) != scan.beams:
        raise ScanError(f"scan with {len(ranges)} ranges of {scan.beams}")
    distances = measured(ranges, scan)
    echo = np.isfinite(distances)
    points = _points(distances, scan, reach, forward)
    field, nearest = nearest_beams(scan, _BEARINGS)
    return ScanView(float(np.count_nonzero(echo)) / scan.beams, points, field & echo[nearest], field)


def nearest_beams(scan: ScanGeometry, bearings: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Return whether each bearing (n,) [rad] is covered by a beam (n,), and the nearest beam's index (n,)."""
    step = abs(scan.angle_increment)
    first = scan.angle_min if scan.angle_increment > 0.0 else scan.angle_min + scan.angle_increment * (scan.beams - 1)
    half = max(0.5 * step, math.pi / DIRECTIONS)
    offset = (bearings - first + 0.5 * step) % _TURN - 0.5 * step
    after_last, before_first = offset - step * (scan.beams - 1), _TURN - offset
    field = np.minimum(after_last, before_first) <= half
    beam = np.minimum(np.rint(offset / step).astype(np.intp), scan.beams - 1)
    beam[before_first < after_last] = 0
    return field, beam if scan.angle_increment > 0.0 else scan.beams - 1 - beam

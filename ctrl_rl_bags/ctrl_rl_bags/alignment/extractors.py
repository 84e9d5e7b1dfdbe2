"""Extracts numbers and objects from messages, and finds jumps of the odometry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import OdometryReader, Scan, read_odometry, read_scan

Array = NDArray[np.float64]

_NEIGHBOURS = 4
_NOISE_M, _NOISE_RAD = 0.03, 0.1
"""Steps that any odometry may deviate from the motion around it [m], [rad]."""
_QUICKER = 1.5
"""Maximum ratio of speeds between two messages, apart from noise."""
_DRAWS = 3
"""Number of neighbours that may be jumps themselves."""


def odometry_jumps(times: NDArray[np.int64], positions: Array, yaws: Array, speeds: Array) -> NDArray[np.intp]:
    """Return the rows before which the pose jumps.

    A step is a jump if neither the odometry's own speeds nor the steps around it explain its length. The latter help
    where a TurtleBot3 reports speed 0 while it drives.

    Args:
        times: Times of the messages (n,) [ns].
        positions: Coordinates (n, 2) or (n, 3) [m].
        yaws: Headings (n,) [rad].
        speeds: Speed and turn rate that the odometry tells (n, 2) [m/s, rad/s].
    """
    if len(times) < 2:
        return np.empty(0, np.intp)
    steps = np.maximum(np.diff(times) * 1e-9, 0.0)
    moved = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    turned = np.abs((np.diff(yaws) + np.pi) % (2.0 * np.pi) - np.pi)
    jumps = np.zeros(len(steps), dtype=np.bool_)
    for way, told, noise in ((moved, speeds[:, 0], _NOISE_M), (turned, speeds[:, 1], _NOISE_RAD)):
        with np.errstate(divide="ignore", invalid="ignore"):
            around = _usual(np.where(steps > 0.0, way / steps, np.nan))
        fast = np.fmax(np.fmax(np.abs(told[:-1]), np.abs(told[1:])), around)
        jumps |= way > _QUICKER * np.nan_to_num(fast) * steps + noise
    return np.flatnonzero(jumps) + 1


def _usual(rates: Array) -> Array:
    """Return for each step the rate that all but a few steps around it stay below."""
    padded = np.concatenate((np.full(_NEIGHBOURS, np.nan), rates, np.full(_NEIGHBOURS, np.nan)))
    near = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1).copy()
    near[:, _NEIGHBOURS] = np.nan
    ordered = np.sort(np.where(np.isnan(near), -1.0, near), axis=1)  # the missing first, the fast last
    usual = ordered[:, -_DRAWS]
    # At the ends of a drive few steps are around: the fastest but one counts there.
    return np.asarray(np.where(usual < 0.0, np.maximum(ordered[:, -_DRAWS + 1], 0.0), usual), dtype=np.float64)


_STATE = OdometryReader(("x", "y", "theta", "v", "omega"))


@dataclass(frozen=True)
class Extractor:
    """Turns a message into a row of numbers, or into one object.

    Attributes:
        read: Function from a message to a row of numbers, or to any object where `columns` is empty; it raises
            CtrlRlError for a message that must not be used.
        columns: Names of the numbers.
        angles: Indices of the columns that are angles [rad] and wrap at pi.
        jumps: Function of times (n,) [ns] and rows (n, columns) that returns the rows before which the robot was moved
            rather than drove; no sequence reaches across. None where nothing can jump.
        stamped: Whether a message's time is its stamp, if it has one, rather than its reception.
    """

    read: Callable[[Any], Any]
    columns: tuple[str, ...] = ()
    angles: tuple[int, ...] = ()
    jumps: Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.intp]] | None = None
    stamped: bool = True

    def array(self, rows: list[Any]) -> NDArray[Any]:
        """Return rows as an array (n, columns) of float64, or (n,) of objects."""
        if self.columns:
            return np.array(rows, dtype=np.float64).reshape(len(rows), len(self.columns))
        out = np.empty(len(rows), dtype=np.object_)
        out[:] = rows
        return out


def _scan(message: Any) -> Scan:
    scan = read_scan(message)
    scan.geometry.check()
    return Scan(scan.ranges.copy(), scan.geometry)


def _odometry(message: Any) -> tuple[float, ...]:
    return tuple(_STATE(read_odometry(message)).tolist())


def _twist(message: Any) -> tuple[float, float]:
    return message.linear.x, message.angular.z


LASER_SCAN = Extractor(_scan)
ODOMETRY = Extractor(
    _odometry,
    ("x", "y", "yaw", "v", "omega"),
    angles=(2,),
    jumps=lambda times, rows: odometry_jumps(times, rows[:, :2], rows[:, 2], rows[:, 3:]),
)
TWIST = Extractor(_twist, ("v", "omega"))
TWIST_STAMPED = Extractor(lambda message: _twist(message.twist), ("v", "omega"))
EXTRACTORS: Mapping[str, Extractor] = {
    "sensor_msgs/msg/LaserScan": LASER_SCAN,
    "nav_msgs/msg/Odometry": ODOMETRY,
    "geometry_msgs/msg/Twist": TWIST,
    "geometry_msgs/msg/TwistStamped": TWIST_STAMPED,
}
"""Default extractor of each message type; x, y [m], yaw [rad], v [m/s], omega [rad/s] as in REP-103."""

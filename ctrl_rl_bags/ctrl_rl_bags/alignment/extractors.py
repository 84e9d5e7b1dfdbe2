"""Takes arrays and numbers out of messages, by message type."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags.alignment.jumps import odometry_jumps
from ctrl_rl_core import OdometryReader, Scan, read_odometry, read_scan

_STATE = OdometryReader(("x", "y", "theta", "v", "omega"))


@dataclass(frozen=True)
class Extractor:
    """Turns a message into a row of numbers, or into one object.

    Attributes:
        read: Function from a message to a row of numbers, or to any object where `columns` is empty; it raises
            CtrlRlError for a message that must not be used.
        columns: Names of the numbers.
        angles: Indices of the columns that are angles [rad] and wrap at pi.
        jumps: Function of times (n,) [ns] and rows (n, columns) that returns the rows before which the robot did not
            drive but was put elsewhere; no sequence reaches across. None where nothing can jump.
        stamped: Whether the stamp of a message is its time, where it has one; otherwise that of its reception is.
    """

    read: Callable[[Any], Any]
    columns: tuple[str, ...] = ()
    angles: tuple[int, ...] = ()
    jumps: Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.intp]] | None = None
    stamped: bool = True

    def array(self, rows: list[Any]) -> NDArray[Any]:
        """Return rows (n) as an array (n, columns) of float64, or (n,) of objects."""
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

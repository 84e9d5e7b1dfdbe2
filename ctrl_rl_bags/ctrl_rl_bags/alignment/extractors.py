"""Takes arrays and numbers out of messages, by message type."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from ctrl_rl_core.geometry.odometry import yaw_of
from numpy.typing import NDArray


@dataclass(frozen=True)
class Scan:
    """One LaserScan: ranges (n,) [m], bearing of the first and step between them [rad], limits [m] (REP-117)."""

    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float


@dataclass(frozen=True)
class Extractor:
    """Turns a message into a row of numbers, or into one object.

    Attributes:
        read: Function from a message to a row of numbers, or to any object where `columns` is empty.
        columns: Names of the numbers.
        angles: Indices of the columns that are angles [rad] and wrap at pi.
    """

    read: Callable[[Any], Any]
    columns: tuple[str, ...] = ()
    angles: tuple[int, ...] = ()

    def array(self, rows: list[Any]) -> NDArray[Any]:
        """Return rows (n) as an array (n, columns) of float64, or (n,) of objects."""
        if self.columns:
            return np.array(rows, dtype=np.float64).reshape(len(rows), len(self.columns))
        out = np.empty(len(rows), dtype=np.object_)
        out[:] = rows
        return out


def _scan(message: Any) -> Scan:
    return Scan(
        np.array(message.ranges, dtype=np.float32),
        float(message.angle_min),
        float(message.angle_increment),
        float(message.range_min),
        float(message.range_max),
    )


def _odometry(message: Any) -> tuple[float, ...]:
    pose, twist = message.pose.pose, message.twist.twist
    return pose.position.x, pose.position.y, yaw_of(pose.orientation), twist.linear.x, twist.angular.z


def _twist(message: Any) -> tuple[float, float]:
    return message.linear.x, message.angular.z


LASER_SCAN = Extractor(_scan)
ODOMETRY = Extractor(_odometry, ("x", "y", "yaw", "v", "omega"), angles=(2,))
TWIST = Extractor(_twist, ("v", "omega"))
TWIST_STAMPED = Extractor(lambda message: _twist(message.twist), ("v", "omega"))
EXTRACTORS: Mapping[str, Extractor] = {
    "sensor_msgs/msg/LaserScan": LASER_SCAN,
    "nav_msgs/msg/Odometry": ODOMETRY,
    "geometry_msgs/msg/Twist": TWIST,
    "geometry_msgs/msg/TwistStamped": TWIST_STAMPED,
}
"""Default extractor of each message type; x, y [m], yaw [rad], v [m/s], omega [rad/s] as in REP-103."""

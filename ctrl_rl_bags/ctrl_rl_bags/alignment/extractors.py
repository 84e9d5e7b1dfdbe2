"""Extracts numbers and objects from messages, and finds odometry jumps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from ctrl_rl_core.sensing import NO_TWIST, lacks_twist, speeds_from_poses
from numpy.typing import NDArray

from ctrl_rl_bags.alignment.resampling import Mend
from ctrl_rl_core import OdometryReader, Scan, read_odometry, read_scan

Array = NDArray[np.float64]
_Jumps = Callable[[NDArray[np.int64], Array], NDArray[np.intp]]

_NEIGHBOURS = 4
_NOISE_M, _NOISE_RAD = 0.03, 0.1
"""Deviations of any odometry step from the surrounding motion that count as noise [m], [rad]."""
_QUICKER = 1.5
"""Maximum ratio of speeds between two messages, apart from noise."""
_DRAWS = 3
"""Number of neighbouring steps that may be jumps themselves."""


def odometry_jumps(times: NDArray[np.int64], positions: Array, yaws: Array, speeds: Array) -> NDArray[np.intp]:
    """Return the rows preceded by a jump of the pose.

    A step is a jump if neither the odometry's own speeds nor the surrounding steps explain its length. The latter are
    needed if a TurtleBot3 reports speed 0 while it drives.

    Args:
        times: Times of the messages (n,) [ns].
        positions: Coordinates (n, 2) or (n, 3) [m].
        yaws: Headings (n,) [rad].
        speeds: Speed and turn rate from odometry (n, 2) [m/s, rad/s].
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
    """Return the usual rate near each step: the `_DRAWS`-th largest at the surrounding steps."""
    padded = np.concatenate((np.full(_NEIGHBOURS, np.nan), rates, np.full(_NEIGHBOURS, np.nan)))
    near = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1).copy()
    near[:, _NEIGHBOURS] = np.nan
    ordered = np.sort(np.where(np.isnan(near), -1.0, near), axis=1)  # missing fields first, fast changes last
    usual = ordered[:, -_DRAWS]
    # Few steps surround those at the ends of a drive, so the second fastest is used there.
    return np.asarray(np.where(usual < 0.0, np.maximum(ordered[:, -_DRAWS + 1], 0.0), usual), dtype=np.float64)


_STATE = OdometryReader(("x", "y", "theta", "v", "omega"))


@dataclass(frozen=True)
class Extractor:
    """Converts a message to a row of numbers, or to one object.

    Attributes:
        read: Function from a message to a row of numbers, or to any object if `columns` is empty; raises CtrlRlError
            for an unusable message.
        columns: Names of the numbers.
        angles: Indices of angular columns [rad], which wrap at pi.
        jumps: Function of times (n,) [ns] and rows (n, columns) that returns the rows preceded by a jump, where
            sequences are split. None if no jumps are possible.
        stamped: Whether to use a message's stamp, if it has one, rather than its reception time.
        mend: Repairs the rows between two clock resets, e.g. odometry without a twist; None if no repair is known.
    """

    read: Callable[[Any], Any]
    columns: tuple[str, ...] = ()
    angles: tuple[int, ...] = ()
    jumps: _Jumps | None = None
    stamped: bool = True
    mend: Mend | None = None

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


def fill_twist(poses: Callable[[Array], Array], first: int, places: Mapping[int, int], jumps: _Jumps) -> Mend:
    """Return a repair function that fills an all-zero twist from the motion of the pose.

    Args:
        poses: Function from rows (n, columns) to x, y, yaw (n, 3) [m, m, rad].
        first: First column of the twist, which occupies the rest of a row.
        places: Quantity to fill in, by column: 0 forward speed, 1 speed to the left, 2 turn rate.
        jumps: As in `Extractor`.
    """

    def mend(times: NDArray[np.int64], rows: Array, tell: Callable[[str], object]) -> Array | None:
        cuts, at = jumps(times, rows), poses(rows)
        if not lacks_twist(times, at, rows[:, first:], cuts):
            return None
        tell(NO_TWIST)
        out = rows.copy()
        out[:, list(places)] = speeds_from_poses(times, at, cuts)[:, list(places.values())]
        return out

    return mend


def _twist(message: Any) -> tuple[float, float]:
    return message.linear.x, message.angular.z


def _jumps(times: NDArray[np.int64], rows: Array) -> NDArray[np.intp]:
    return odometry_jumps(times, rows[:, :2], rows[:, 2], rows[:, 3:])


LASER_SCAN = Extractor(_scan)
ODOMETRY = Extractor(
    _odometry,
    ("x", "y", "yaw", "v", "omega"),
    angles=(2,),
    jumps=_jumps,
    mend=fill_twist(lambda rows: rows[:, :3], 3, {3: 0, 4: 2}, _jumps),
)
TWIST = Extractor(_twist, ("v", "omega"))
TWIST_STAMPED = Extractor(lambda message: _twist(message.twist), ("v", "omega"))
EXTRACTORS: Mapping[str, Extractor] = {
    "sensor_msgs/msg/LaserScan": LASER_SCAN,
    "nav_msgs/msg/Odometry": ODOMETRY,
    "geometry_msgs/msg/Twist": TWIST,
    "geometry_msgs/msg/TwistStamped": TWIST_STAMPED,
}
"""Default extractor per message type; x, y [m], yaw [rad], v [m/s], omega [rad/s] as in REP-103."""

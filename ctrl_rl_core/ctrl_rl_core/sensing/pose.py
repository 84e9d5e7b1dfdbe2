"""Validated poses from messages: finite positions, and quaternions that are rotations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.errors import CtrlRlError

Array = NDArray[np.float64]

_FARTHEST = 1e7
"""Upper bound of a robot's distance from its origin [m]."""
_NORM_ERROR = 0.01
"""Deviation of a quaternion's norm from 1 attributed to rounding; drivers without orientation send zeros."""

_ROUNDING = 1e-9
_UPRIGHT = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
_WITHOUT_HEADING = np.array((1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0))


class PoseError(CtrlRlError):
    """A pose is invalid; the message gives the reason."""


def read_pose(position: Any, orientation: Any) -> Array:
    """Read position and unit quaternion x, y, z, w (7,) from a message's fields.

    Raises:
        PoseError: A number is not finite or far too large, or the quaternion is not a rotation (such as all zeros).
    """
    numbers = (position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w)
    out = np.array(numbers, np.float64)
    if not (np.abs(out[:3]) <= _FARTHEST).all():
        raise PoseError(f"a translation of {out[:3].tolist()} m")
    with np.errstate(over="ignore"):  # for values rejected below
        norm = math.sqrt(out[3:].dot(out[3:]))
    if not abs(norm - 1.0) <= _NORM_ERROR:
        raise PoseError(f"a quaternion of length {norm:.3g}: must be 1")
    if abs(norm - 1.0) > _ROUNDING:  # leave others unchanged, bit by bit
        out[3:] /= norm
    return out


def read_goal(pose: Any) -> Array:
    """Read position and quaternion (7,) of a goal from a geometry_msgs/Pose; a zero quaternion means no heading.

    Raises:
        PoseError: The pose is invalid, see `read_pose`.
    """
    turn = pose.orientation
    if turn.x == turn.y == turn.z == turn.w == 0.0:
        return read_pose(pose.position, _UPRIGHT) * _WITHOUT_HEADING
    return read_pose(pose.position, turn)


def read_planar_pose(pose: Any) -> Array:
    """Read x, y, yaw (3,) [m, m, rad] from a geometry_msgs/Pose.

    Raises:
        PoseError: The pose is invalid, see `read_pose`.
    """
    return planar(read_pose(pose.position, pose.orientation).tolist())


def planar(pose: Sequence[float]) -> Array:
    """Convert position and quaternion (7,) to x, y, yaw (3,); yaw is NaN for a goal without a heading."""
    turn = pose[3:7]
    return np.array((pose[0], pose[1], yaw_of(*turn) if any(turn) else math.nan))


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """Return the heading of a quaternion, in (-pi, pi]."""
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def pitch_of(x: float, y: float, z: float, w: float) -> float:
    """Return the rotation of a quaternion about +y, in (-pi, pi]."""
    return math.atan2(2.0 * (w * y - z * x), 1.0 - 2.0 * (x * x + y * y))

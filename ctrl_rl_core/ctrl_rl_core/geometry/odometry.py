"""From nav_msgs/Odometry to the state of a system model.

Odometry is REP-103: pose in its frame, twist in the body's. A model's state is x, y, theta (counter-clockwise) with
speeds along the body for what drives, and x, z, psi (about +y, from z towards x) with speeds along the frame's axes for
the planar quadrotor. Messages may come from rclpy or from a bag.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.errors import CtrlRlError

_COMPONENTS: Mapping[str, Callable[[Any, Any, float, float], float]] = {
    "x": lambda pose, _twist, _yaw, _pitch: pose.position.x,
    "y": lambda pose, _twist, _yaw, _pitch: pose.position.y,
    "z": lambda pose, _twist, _yaw, _pitch: pose.position.z,
    "theta": lambda _pose, _twist, yaw, _pitch: yaw,
    "psi": lambda _pose, _twist, _yaw, pitch: pitch,
    "v": lambda _pose, twist, _yaw, _pitch: twist.linear.x,
    "v_x": lambda _pose, twist, _yaw, pitch: math.cos(pitch) * twist.linear.x + math.sin(pitch) * twist.linear.z,
    "v_z": lambda _pose, twist, _yaw, pitch: math.cos(pitch) * twist.linear.z - math.sin(pitch) * twist.linear.x,
}


class OdometryError(CtrlRlError):
    """A state cannot be read from odometry."""


def yaw_of(q: Any) -> float:
    """Return the heading of a quaternion of a message, in (-pi, pi]."""
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


class OdometryReader:
    """Reads the state of one kind of robot from odometry messages.

    Args:
        names: The state's components, in order: those of a model in the x-y or the x-z plane.

    Raises:
        OdometryError: Odometry does not tell one of them.
    """

    def __init__(self, names: Sequence[str]) -> None:
        unknown = [name for name in names if name not in (*_COMPONENTS, "omega")]
        if unknown:
            raise OdometryError(f"odometry does not tell '{unknown[0]}': it tells {', '.join(_COMPONENTS)} and omega")
        flies = "psi" in names
        turn = (lambda _p, twist, _y, _a: twist.angular.y) if flies else (lambda _p, twist, _y, _a: twist.angular.z)
        self._components = [turn if name == "omega" else _COMPONENTS[name] for name in names]

    def __call__(self, message: Any) -> NDArray[np.float64]:
        """Return the state (n,) in SI units; angles in (-pi, pi]."""
        pose, twist = message.pose.pose, message.twist.twist
        q, yaw = pose.orientation, yaw_of(pose.orientation)
        pitch = math.atan2(2.0 * (q.w * q.y - q.z * q.x), 1.0 - 2.0 * (q.x * q.x + q.y * q.y))
        return np.array([component(pose, twist, yaw, pitch) for component in self._components])

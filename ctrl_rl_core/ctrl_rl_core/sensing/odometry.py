"""Odometry as an array, and its conversion to the state of a system model.

Odometry follows REP-103: pose in its own frame, twist in the body frame. It is stored as an array (13,) with the
components `ODOMETRY_NAMES`. The state of a ground robot is x, y, theta (counter-clockwise) with speeds in the body
frame; that of the planar quadrotor is x, z, psi (about +y, from z towards x) with speeds along the axes of the odometry
frame. Messages may come from rclpy or a bag.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.sensing.pose import PoseError, pitch_of, read_pose, yaw_of

Array = NDArray[np.float64]

ODOMETRY_NAMES = (
    *("x", "y", "z", "q_x", "q_y", "q_z", "q_w"),
    *("v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z"),
)
"""Position [m], quaternion, velocity [m/s] and turn rates [rad/s] in the body frame."""
V, V_Y, _V_Z, _OMEGA_Y, OMEGA_Z = 7, 8, 9, 11, 12
"""Indices of the forward speed, the speed to the left, the vertical speed, and the turn rates about y and z."""
_FASTEST = 1e6
"""Upper bound of any robot's speeds [m/s, rad/s]."""
_COMPONENTS: Mapping[str, Callable[[Sequence[float], float, float], float]] = {
    "x": lambda it, _yaw, _pitch: it[0],
    "y": lambda it, _yaw, _pitch: it[1],
    "z": lambda it, _yaw, _pitch: it[2],
    "theta": lambda _it, yaw, _pitch: yaw,
    "psi": lambda _it, _yaw, pitch: pitch,
    "v": lambda it, _yaw, _pitch: it[V],
    "v_x": lambda it, _yaw, pitch: math.cos(pitch) * it[V] + math.sin(pitch) * it[_V_Z],
    "v_z": lambda it, _yaw, pitch: math.cos(pitch) * it[_V_Z] - math.sin(pitch) * it[V],
}


class OdometryError(CtrlRlError):
    """Odometry is unusable, or does not contain the requested state."""


def read_odometry(message: Any) -> Array:
    """Convert a nav_msgs/Odometry to an array (13,), see `ODOMETRY_NAMES`.

    Raises:
        OdometryError: A number is not finite or far too large, or the quaternion is not a rotation (such as all zeros).
    """
    pose, linear, angular = message.pose.pose, message.twist.twist.linear, message.twist.twist.angular
    out = np.empty(len(ODOMETRY_NAMES))
    out[7:] = linear.x, linear.y, linear.z, angular.x, angular.y, angular.z
    if not (np.abs(out[7:]) <= _FASTEST).all():
        if math.isfinite(linear.x) and math.isfinite(angular.z):
            raise OdometryError(f"odometry with a twist of {out[7:].tolist()}")
        raise OdometryError(f"odometry with speed {linear.x} and turn rate {angular.z}")
    try:
        out[:7] = read_pose(pose.position, pose.orientation)
    except PoseError as error:
        raise OdometryError(f"odometry with {error}") from None
    return out


def make_odometry(pose: Array, velocity: Array, plane: str = "xy") -> Array:
    """Create odometry (13,) of a planar robot.

    Args:
        pose: Two coordinates in the plane and the angle (3,) [m, m, rad].
        velocity: Velocity along the body's axes in the plane, and the turn rate (3,) [m/s, m/s, rad/s].
        plane: "xy" for ground robots, "xz" for flying ones.
    """
    first, second, angle = pose.tolist()
    along, aside, turn = velocity.tolist()
    sine, cosine = math.sin(0.5 * angle), math.cos(0.5 * angle)
    if plane == "xy":
        return np.array((first, second, 0.0, 0.0, 0.0, sine, cosine, along, aside, 0.0, 0.0, 0.0, turn))
    return np.array((first, 0.0, second, 0.0, sine, 0.0, cosine, along, 0.0, aside, 0.0, turn, 0.0))


class OdometryReader:
    """Reads the state of one kind of robot from odometry.

    Args:
        names: Components of the state, in order, of a model in the x-y or the x-z plane.

    Raises:
        OdometryError: A component is not available from odometry.
    """

    def __init__(self, names: Sequence[str]) -> None:
        unknown = [name for name in names if name not in (*_COMPONENTS, "omega")]
        if unknown:
            raise OdometryError(
                f"odometry does not contain '{unknown[0]}': it contains {', '.join(_COMPONENTS)} and omega"
            )
        self._uses_twist = any(name.startswith(("v", "omega")) for name in names)
        turn = _OMEGA_Y if "psi" in names else OMEGA_Z
        self._components = [
            (lambda it, _yaw, _pitch: it[turn]) if name == "omega" else _COMPONENTS[name] for name in names
        ]

    @property
    def uses_twist(self) -> bool:
        """Whether any component comes from the twist."""
        return self._uses_twist

    def __call__(self, odometry: Array) -> Array:
        """Convert odometry (13,) to the state (n,) in SI units; angles in (-pi, pi]."""
        numbers = odometry.tolist()
        yaw, pitch = yaw_of(*numbers[3:7]), pitch_of(*numbers[3:7])
        return np.array([component(numbers, yaw, pitch) for component in self._components])

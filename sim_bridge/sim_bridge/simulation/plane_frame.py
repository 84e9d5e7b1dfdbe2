"""Converts planar poses and velocities between system states and body axes."""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.tasks import ANGLES, wrap_one
from numpy.typing import NDArray

from ctrl_rl_core import System

Array = NDArray[np.float64]


class PlaneFrame:
    """A plane, "xy" or "xz", and the names of a system's states in it."""

    def __init__(self, plane: str, system: System) -> None:
        self._plane, self._names = plane, system.state_names
        self._sense = 1.0 if plane == "xy" else -1.0  # psi is clockwise in the x-z plane

    def named(self, pose: Array, velocity: Array) -> Array:
        """Return the state (n,) in the system's order, angles in [-pi, pi).

        Args:
            pose: x, y, theta or x, z, psi (3,) [m, m, rad].
            velocity: Rates of the pose (3,) [m/s, m/s, rad/s].
        """
        angle = wrap_one(float(pose[2]))
        if self._plane == "xy":
            values = {"x": pose[0], "y": pose[1], "theta": angle, "omega": velocity[2]}
            values["v"] = velocity[0] * math.cos(angle) + velocity[1] * math.sin(angle)
        else:
            values = {"x": pose[0], "z": pose[1], "psi": angle}
            values |= {"v_x": velocity[0], "v_z": velocity[1], "omega": velocity[2]}
        return np.array([values[name] for name in self._names])

    def placed(self, state: Array, pose: Array) -> Array:
        """Return a state (n,) with its position and heading replaced by a pose (3,)."""
        out = state.copy()
        for names, value in ((("x",), pose[0]), ((self._plane[1],), pose[1]), (ANGLES, wrap_one(float(pose[2])))):
            index = next((index for index, name in enumerate(self._names) if name in names), None)
            if index is not None:
                out[index] = value
        return out

    def in_body_axes(self, angle: float, velocity: Array) -> Array:
        """Rotate a velocity (3,) into the axes of a body at an angle [rad]."""
        c, s = math.cos(angle), self._sense * math.sin(angle)
        return np.array((c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0], velocity[2]))

    def from_body_axes(self, angle: float, velocity: Array) -> Array:
        """Rotate a velocity (3,) into the axes of the plane; the inverse of `in_body_axes`."""
        c, s = math.cos(angle), self._sense * math.sin(angle)
        return np.array((c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1], velocity[2]))

    def counter_clockwise(self, pose: Array) -> Array:
        """Convert a pose (3,) to or from a counter-clockwise angle; the function is its own inverse."""
        return pose * (1.0, 1.0, self._sense)

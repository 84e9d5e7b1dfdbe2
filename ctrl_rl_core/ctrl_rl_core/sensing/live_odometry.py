"""Odometry of a running robot, with speeds even if its base always reports a twist of zero; without ROS."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.sensing.odometry import OMEGA_Z, V_Y, V, read_odometry
from ctrl_rl_core.sensing.odometry_health import JUMP, PAUSE, OdometryHealth
from ctrl_rl_core.sensing.pose import yaw_of
from ctrl_rl_core.sensing.pose_speeds import SPAN_NS, ZERO, body_velocity

Array = NDArray[np.float64]

_CLIMB = 0.1
"""Change of height beyond which speeds in the plane do not describe the motion [m]."""
_SHOWN = 0.1
"""Distance that a pose must move before its missing twist is reported [m]."""


class LiveOdometry:
    """Reads a robot's odometry, message after message, by the rule that bags are read by.

    Until a twist differs from zero, speeds are those of the pose's motion in the last 0.1 s: some TurtleBot3 never
    report others. From then on the twist is used, and must explain how the pose moves (`OdometryHealth`).

    Attributes:
        fault: Description of a contradiction between pose and twist; empty if there is none.
        lacks_twist: Whether the pose has moved while every twist was zero.
    """

    def __init__(self) -> None:
        self.fault, self.lacks_twist = "", False
        self._health, self._has_twist = OdometryHealth(), False
        self._poses: deque[tuple[int, Array]] = deque()
        self._first: Array | None = None

    def read(self, message: Any) -> Array:
        """Convert a nav_msgs/Odometry to an array (13,), see `ODOMETRY_NAMES`, and update `fault`.

        Raises:
            OdometryError: A number or the quaternion is unusable.
        """
        odometry = read_odometry(message)
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        first = self._first = odometry[:3] if self._first is None else self._first
        if np.abs(odometry[7:]).max() > ZERO or abs(odometry[2] - first[2]) > _CLIMB:
            self._has_twist, self.lacks_twist = True, False
        if self._has_twist:
            self.fault = self._health.update(stamp, odometry)
        else:
            odometry[[V, V_Y, OMEGA_Z]] = self._velocity(stamp, odometry)
            self.lacks_twist = self.lacks_twist or math.dist(odometry[:2], first[:2]) > _SHOWN
        return odometry

    def _velocity(self, stamp: int, odometry: Array) -> Array:
        """Return forward speed, speed to the left and turn rate (3,) from the motion of the pose."""
        pose, kept = np.array((*odometry[:2], yaw_of(*odometry[3:7]))), self._poses
        if kept and not (0 < stamp - kept[-1][0] <= 1e9 * PAUSE and math.dist(pose[:2], kept[-1][1][:2]) <= JUMP):
            kept.clear()  # a repetition, a pause, an adjusted clock, or another origin
        kept.append((stamp, pose))
        while len(kept) > 1 and stamp - kept[1][0] >= SPAN_NS:
            kept.popleft()
        before, at = kept[0]
        return body_velocity(at[None], pose[None], np.array([1e-9 * (stamp - before)]))[0]

"""Validates sensor messages; provides odometry with its age, now and at the time of a scan."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.navigation import OdometryTrack
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.filter.verdict import Reading

Array = NDArray[np.float64]

AHEAD = 0.1
"""Maximum time by which a stamp may be ahead of this computer's clock [s], since clocks of two computers differ."""
_FARTHEST_JUMP = 0.3
"""Distance beyond that at maximum speed which indicates a new odometry origin [m]."""


def age_of(what: str, stamp: int, clock: int, timeout: float, ahead: float = AHEAD) -> float:
    """Return the age of a message that arrives now [s]; zero if its stamp is slightly in the future.

    Args:
        what: Name of the message, for errors.
        stamp: Stamp of the message [ns].
        clock: Current time of the node's clock [ns].
        timeout: Maximum age [s].
        ahead: Maximum time by which the stamp may be ahead of the clock [s].

    Raises:
        SafetyError: The stamp is in the future, or the message is too old.
    """
    age = 1e-9 * (clock - stamp)
    if age < -ahead:
        raise SafetyError(f"{what} is stamped {-age:.2f} s ahead of this clock: set the clocks of both computers")
    if age > timeout:
        raise SafetyError(f"{what} is {age:.2f} s old on arrival: set the clocks of both computers, or use_sim_time")
    return max(age, 0.0)


def beam_times(points: Array, scan: ScanGeometry, increment: float, forward: float, longest: float) -> Array:
    """Return the times of echoes relative to their scan's stamp, which is that of the first beam (n,) [s].

    Args:
        points: Echoes in the robot's frame (n, 2) [m].
        scan: Bearings of the scan's beams.
        increment: Time between beams [s]; 0 for an instantaneous scan.
        forward: Position of the lidar ahead of the robot's centre [m].
        longest: Maximum duration of a scan [s].

    Raises:
        SafetyError: The scan takes longer, or its time runs backwards.
    """
    if not 0.0 <= increment * scan.beams <= longest:
        raise SafetyError(f"the scan's time_increment of {increment} s makes {increment * scan.beams:.3g} s a scan")
    turned = np.arctan2(points[:, 1], points[:, 0] - forward) - scan.angle_min
    turned = np.mod(math.copysign(1.0, scan.angle_increment) * turned, 2.0 * math.pi)
    beams = np.rint(turned / abs(scan.angle_increment))
    return np.asarray(increment * np.where(beams < scan.beams, beams, 0.0), np.float64)


class OdometryInput:
    """The latest odometry.

    Args:
        fastest: Maximum speed of the robot [m/s].
        timeout: Maximum age of odometry [s].
        ahead: Maximum time by which its stamp may be ahead of the clock [s].

    Attributes:
        frame: Frame of the poses.
        jumps: Number of pose jumps, e.g. to a new origin.
    """

    def __init__(self, fastest: float, timeout: float, ahead: float) -> None:
        self._fastest, self._timeout, self._ahead = fastest, timeout, ahead
        self._track = OdometryTrack()
        self._at, self._age, self._stamp = -math.inf, math.inf, 0
        self._pose, self._v, self._omega = np.full(3, math.nan), 0.0, 0.0
        self.frame, self.jumps = "odom", 0

    def update(self, message: Any, now: float, clock: int) -> bool:
        """Process a nav_msgs/Odometry and return whether the pose has jumped.

        Args:
            message: Odometry with a finite twist.
            now: Steady time [s].
            clock: Current time of the node's clock [ns].

        Raises:
            SafetyError: The stamp is too old or in the future.
            TransformError: The pose is invalid.
        """
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        age = age_of("odometry", stamp, clock, self._timeout, self._ahead)
        self._track.update(message, now)
        pose, passed = self._track.latest().pose, 1e-9 * (stamp - self._stamp)
        way = math.hypot(pose[0] - self._pose[0], pose[1] - self._pose[1])
        jumped = passed < 0.0 or way > self._fastest * passed + _FARTHEST_JUMP
        if jumped:  # no pose between those before and after
            self._track = OdometryTrack()
            self._track.update(message, now)
        twist = message.twist.twist
        self._at, self._age, self._stamp, self._pose = now, age, stamp, pose
        self._v, self._omega, self.frame = twist.linear.x, twist.angular.z, self._track.frame or "odom"
        self.jumps += jumped
        return jumped

    def reading(self, now: float) -> Reading:
        """Return the last odometry reading, with its age at a steady time [s]."""
        return Reading(self._pose, self._v, self._omega, max(now - self._at, 0.0) + self._age)

    def straightened(self, points: Array, times: Array, stamp: int) -> Array:
        """Return echoes (n, 2) in the robot's frame at the stamp of their scan [ns], corrected for motion [m].

        Args:
            points: Echoes, each in the robot's frame at its own time (n, 2) [m].
            times: Times after the stamp (n,) [s].
            stamp: Stamp of the scan [ns].

        Raises:
            TransformError: The odometry does not cover that time.
        """
        longest = float(times.max(initial=0.0))
        if longest == 0.0:
            return points
        first, last = self.pose_at(stamp), self.pose_at(stamp + round(1e9 * longest))
        turn = math.remainder(last[2] - first[2], 2.0 * math.pi)
        share = times / longest
        theta, (c, s) = share * turn, (math.cos(first[2]), math.sin(first[2]))
        dx, dy = last[0] - first[0], last[1] - first[1]
        x, y = points.T
        ahead = share * (c * dx + s * dy) + np.cos(theta) * x - np.sin(theta) * y
        aside = share * (c * dy - s * dx) + np.sin(theta) * x + np.cos(theta) * y
        return np.column_stack((ahead, aside))

    def pose_at(self, stamp: int) -> Array:
        """Return the pose (3,) [m, m, rad] at a stamp [ns], extrapolated with the last speeds if necessary.

        Raises:
            TransformError: The odometry does not cover that time.
        """
        pose: Array = self._track.at(stamp).pose
        ahead = 1e-9 * (stamp - self._stamp)
        if ahead <= 0.0:
            return pose
        middle, way = pose[2] + 0.5 * self._omega * ahead, self._v * ahead
        return pose + np.array((way * math.cos(middle), way * math.sin(middle), self._omega * ahead))

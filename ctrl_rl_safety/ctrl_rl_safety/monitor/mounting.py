"""Estimate the mounting angle of a lidar from the motion of its echoes while the robot drives.

Echoes of stationary objects, transformed by the robot's measured motion, must agree with the next scan. If the lidar is
rotated by an unknown angle, the echoes shift sideways instead, in proportion to the distance driven. So this module
compares scans from several points on a straight path under each of several angles.
"""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ANGLES = np.radians(
    (0, 5, -5, 10, -10, 15, -15, 20, -20, 30, -30, 45, -45, 60, -60, 90, -90, 120, -120, 150, -150, 180.0)
)
_STRIDE = 0.2
"""Distance between two scans that are compared [m]."""
_TURNED = 0.2
"""Largest rotation between them [rad]: on a curve errors of the odometry's heading count for more."""
_SURFACE = 0.3
"""Maximum distance of neighbouring echoes on one surface [m]."""
_FARTHEST = 0.2
"""Distance at which disagreements are capped, so that moving objects have little influence [m]."""
_FEWEST, _MOST_BEGIN, _MOST_END = 12, 240, 80
"""Fewest echoes of a scan, and the most that are used of the earlier and of the later one."""
_BEFORE = 0.8
"""Weight of earlier comparisons relative to a new one."""
_PAIRS = 1.75
"""Total weight of comparisons from which an angle is accepted."""
_CLEARLY = 0.5
"""Disagreement at the angle relative to that at zero."""
_WRONG, _RIGHT = 0.02, 0.015
"""Mean disagreement from which on an angle is wrong, and up to which it is right, whatever moves [m]."""


@cached_njit
def _disagreements(
    before: Array, linked: NDArray[np.bool_], after: Array, motion: Array, forward: float, angles: Array
) -> Array:
    """Return the mean distance of echoes from the surfaces of an earlier scan, for each angle (k,) [m].

    Args:
        before: Echoes of the earlier scan in the lidar's frame, in beam order (n, 2) [m].
        linked: Whether each of them and the next one belong to one surface (n,).
        after: Echoes of the later scan in the lidar's frame (m, 2) [m].
        motion: Pose of the robot at the later scan in its frame at the earlier one (3,) [m, m, rad].
        forward: Position of the lidar ahead of the robot's centre [m].
        angles: Angles by which the lidar may be turned (k,) [rad].
    """
    out = np.empty(len(angles))
    c, s = math.cos(motion[2]), math.sin(motion[2])
    gaps = np.empty(len(after))
    for k in range(len(angles)):
        ca, sa = math.cos(angles[k]), math.sin(angles[k])
        for i in range(len(after)):
            x, y = forward + ca * after[i, 0] - sa * after[i, 1], sa * after[i, 0] + ca * after[i, 1]
            x, y = motion[0] + c * x - s * y - forward, motion[1] + s * x + c * y
            x, y = ca * x + sa * y, ca * y - sa * x
            least = _FARTHEST * _FARTHEST
            for j in range(len(before)):
                dx, dy = x - before[j, 0], y - before[j, 1]
                if linked[j]:
                    n = (j + 1) % len(before)
                    ex, ey = before[n, 0] - before[j, 0], before[n, 1] - before[j, 1]
                    share = min(max((dx * ex + dy * ey) / max(ex * ex + ey * ey, 1e-12), 0.0), 1.0)
                    dx, dy = dx - share * ex, dy - share * ey
                least = min(least, dx * dx + dy * dy)
            gaps[i] = math.sqrt(least)
        # Objects that only one of the scans sees give no information about the angle.
        out[k] = np.sort(gaps)[: max(1, (3 * len(gaps)) // 4)].mean()
    return out


class Mounting:
    """Mounting angle of the lidar relative to the configured one.

    Args:
        forward: Position of the lidar ahead of the robot's centre [m].

    Attributes:
        yaw: Angle by which the lidar is rotated [rad]; 0 without evidence for another angle.
        problem: Reason why the robot must stop; empty if there is none.
    """

    def __init__(self, forward: float) -> None:
        self._forward = forward
        self.yaw, self.problem = 0.0, ""
        self._sums, self._weight = np.zeros(len(_ANGLES)), 0.0
        self._before: tuple[Array, Array] | None = None

    def forget(self) -> None:
        """Forget the last scan, because the odometry frame has jumped."""
        self._before = None

    def look(self, pose: Array, echoes: Array) -> None:
        """Compare a scan with the previous one.

        Args:
            pose: Pose of the robot at the time of the scan (3,) [m, m, rad].
            echoes: Echoes in the robot's frame, in beam order (n, 2) [m].
        """
        points = np.ascontiguousarray(echoes - (self._forward, 0.0))
        if len(points) < _FEWEST or self.problem:
            return
        if self._before is None:
            self._before = pose.copy(), points
            return
        begin, before = self._before
        motion = _from(begin, pose)
        if abs(motion[2]) > _TURNED:
            self._before = pose.copy(), points
        elif math.hypot(motion[0], motion[1]) >= _STRIDE:
            self._before = pose.copy(), points
            self._compare(before, points, motion)

    def _compare(self, before: Array, after: Array, motion: Array) -> None:
        before, after = (
            each[:: math.ceil(len(each) / most)] for each, most in ((before, _MOST_BEGIN), (after, _MOST_END))
        )
        linked = np.hypot(*(np.roll(before, -1, axis=0) - before).T) < _SURFACE
        found = _disagreements(before, linked, np.ascontiguousarray(after), motion, self._forward, _ANGLES)
        self._sums, self._weight = _BEFORE * self._sums + found, _BEFORE * self._weight + 1.0
        best = int(np.argmin(self._sums))
        if self._weight < _PAIRS or best == 0 or self._sums[0] < _WRONG * self._weight:
            return
        if self._sums[best] < min(_CLEARLY * self._sums[0], _RIGHT * self._weight):
            self.yaw = float(_ANGLES[best])
            self.problem = (
                f"the lidar is turned by about {math.degrees(self.yaw):.0f} degrees against the direction of travel: "
                "mount it as told or correct lidar_yaw, then start the filter again"
            )


def _from(begin: Array, end: Array) -> Array:
    """Return a pose (3,) in the frame of another one (3,) [m, m, rad]."""
    c, s = math.cos(begin[2]), math.sin(begin[2])
    dx, dy = end[0] - begin[0], end[1] - begin[1]
    return np.array((c * dx + s * dy, c * dy - s * dx, math.remainder(end[2] - begin[2], 2.0 * math.pi)))

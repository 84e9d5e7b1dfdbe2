"""Velocity from the motion of the pose, for bases whose odometry has a zero twist while they drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Times = NDArray[np.int64]

SPAN_NS = 100_000_000
"""Time span over which the pose's motion is measured [ns], since messages are irregular and their poses rounded."""
_WINDOW_NS = 2_000_000_000
"""Time within which a pose must move to contradict a zero twist [ns]."""
ZERO = 1e-6
"""Largest twist that counts as zero [m/s, rad/s]; a TurtleBot3 reports 1e-12."""
NO_TWIST = "its twist is always zero: speeds are those of the pose's motion"
"""What a user is told of such odometry."""
_WAY, _TURN = 0.1, 0.4
"""Displacement [m] and rotation [rad] beyond the noise of a stationary robot."""


def speeds_from_poses(times: Times, poses: Array, cuts: NDArray[np.intp]) -> Array:
    """Return forward speed, speed to the left and turn rate (n, 3) [m/s, m/s, rad/s] from the motion of poses.

    Each speed is an average over the last 0.1 s, without future poses.

    Args:
        times: Times of the poses (n,) [ns], increasing.
        poses: Poses x, y, yaw (n, 3) [m, m, rad].
        cuts: Rows preceded by a jump of the pose, across which no speed is computed.
    """
    before = _rows_before(times, SPAN_NS, cuts)
    rows = np.arange(len(times))
    first = before == rows  # after a jump, use the motion that follows, the nearest known
    now = np.where(first & ~np.isin(rows + 1, cuts), np.minimum(rows + 1, len(rows) - 1), rows)
    return body_velocity(poses[before], poses[now], 1e-9 * (times[now] - times[before]).astype(np.float64))


def body_velocity(before: Array, after: Array, passed: Array) -> Array:
    """Return mean forward speed, speed to the left and turn rate (n, 3) between poses; 0 where no time has passed.

    Args:
        before: Poses x, y, yaw (n, 3) [m, m, rad].
        after: Later poses (n, 3).
        passed: Time in between (n,) [s].
    """
    moved = after - before
    turned = np.remainder(moved[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    heading = before[:, 2] + 0.5 * turned
    cos, sin = np.cos(heading), np.sin(heading)
    ways = np.stack((cos * moved[:, 0] + sin * moved[:, 1], cos * moved[:, 1] - sin * moved[:, 0], turned), axis=1)
    return np.divide(ways, passed[:, None], out=np.zeros_like(ways), where=passed[:, None] > 0.0)


def lacks_twist(times: Times, poses: Array, twists: Array, cuts: NDArray[np.intp]) -> bool:
    """Return whether the twist is zero in every message although the pose moves.

    Args:
        times: Times (n,) [ns], increasing.
        poses: Poses x, y, yaw (n, 3) [m, m, rad].
        twists: Components of the twist (n, k).
        cuts: Rows preceded by a jump of the pose, which does not count as motion.
    """
    if not len(times) or np.any(np.abs(twists) > ZERO):
        return False
    before = _rows_before(times, _WINDOW_NS, cuts)
    moved = poses - poses[before]
    turned = np.remainder(moved[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    return bool((np.linalg.norm(moved[:, :2], axis=1) >= _WAY).any() or (np.abs(turned) >= _TURN).any())


def _rows_before(times: Times, span: int, cuts: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return, for each time, the last row at least this long before [ns], but after the last jump."""
    rows = np.maximum(np.searchsorted(times, times - span, side="right") - 1, 0)
    last_cut = np.zeros(len(times), dtype=np.intp)
    last_cut[cuts] = cuts
    return np.maximum(rows, np.maximum.accumulate(last_cut))

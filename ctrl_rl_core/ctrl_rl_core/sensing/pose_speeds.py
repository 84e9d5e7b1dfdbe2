"""Velocity from the motion of the pose, for bases whose odometry publishes a twist of zero while they drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Times = NDArray[np.int64]

_SPAN_NS = 100_000_000
"""Time over which the pose's motion is measured: single messages come unevenly, and their poses are rounded [ns]."""
_WINDOW_NS = 2_000_000_000
"""Time within which a pose must have moved before a twist of zero contradicts it [ns]."""
_ZERO = 1e-6
"""Twist that means none [m/s, rad/s]: a TurtleBot3 tells 1e-12."""
_WAY, _TURN = 0.1, 0.4
"""Way [m] and turn [rad] that no noise of a standing robot makes."""


def speeds_from_poses(times: Times, poses: Array, cuts: NDArray[np.intp]) -> Array:
    """Return speed ahead, speed to the left and turn rate (n, 3) [m/s, m/s, rad/s] by the motion of poses.

    Each is that of the last 0.1 s, so that a speed knows nothing of what came later.

    Args:
        times: Times of the poses (n,) [ns], rising.
        poses: Poses x, y, yaw (n, 3) [m, m, rad].
        cuts: Rows before which the pose jumps: no speed reaches across.
    """
    before = _rows_before(times, _SPAN_NS, cuts)
    rows = np.arange(len(times))
    first = before == rows  # after a jump, use the motion that follows, the nearest known
    now = np.where(first & ~np.isin(rows + 1, cuts), np.minimum(rows + 1, len(rows) - 1), rows)
    passed = (times[now] - times[before]) * 1e-9
    moved = poses[now] - poses[before]
    turned = np.remainder(moved[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    heading = poses[before, 2] + 0.5 * turned
    cos, sin = np.cos(heading), np.sin(heading)
    ways = np.stack((cos * moved[:, 0] + sin * moved[:, 1], cos * moved[:, 1] - sin * moved[:, 0], turned), axis=1)
    return np.divide(ways, passed[:, None], out=np.zeros_like(ways), where=passed[:, None] > 0.0)


def lacks_twist(times: Times, poses: Array, twists: Array, cuts: NDArray[np.intp]) -> bool:
    """Return whether a twist is zero in every message although the pose moves.

    Args:
        times: Times (n,) [ns], rising.
        poses: Poses x, y, yaw (n, 3) [m, m, rad].
        twists: Numbers of the twist (n, k).
        cuts: Rows before which the pose jumps, which is no motion.
    """
    if not len(times) or np.any(np.abs(twists) > _ZERO):
        return False
    before = _rows_before(times, _WINDOW_NS, cuts)
    moved = poses - poses[before]
    turned = np.remainder(moved[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    return bool((np.linalg.norm(moved[:, :2], axis=1) >= _WAY).any() or (np.abs(turned) >= _TURN).any())


def _rows_before(times: Times, span: int, cuts: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return for each time the row that is as long before [ns] or a little longer, but after the last jump."""
    rows = np.maximum(np.searchsorted(times, times - span, side="right") - 1, 0)
    last_cut = np.zeros(len(times), dtype=np.intp)
    last_cut[cuts] = cuts
    return np.maximum(rows, np.maximum.accumulate(last_cut))

"""Jumps of a robot's odometry: resets, corrections, a robot that was carried. What lies on both sides is no drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_NEIGHBOURS = 4
_NOISE_M, _NOISE_RAD = 0.03, 0.1
"""Steps by which any odometry may differ from the motion around it."""
_QUICKER = 1.5
"""A robot speeds up by no more than this between two messages, other than by noise."""
_DRAWS = 3
"""Neighbours that may be jumps themselves."""


def odometry_jumps(times: NDArray[np.int64], positions: Array, yaws: Array, speeds: Array) -> NDArray[np.intp]:
    """Return the rows before which the pose jumps.

    A step is a jump where it is longer than the odometry's own speeds and the steps around it explain; a TurtleBot3
    that says speed 0 while it drives has the latter.

    Args:
        times: Times of the messages (n,) [ns].
        positions: Coordinates (n, 2) or (n, 3) [m].
        yaws: Headings (n,) [rad].
        speeds: Speed and turn rate that the odometry tells (n, 2) [m/s, rad/s].
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
    """Return for each step the rate that all but a few of the steps around it stay below."""
    padded = np.concatenate((np.full(_NEIGHBOURS, np.nan), rates, np.full(_NEIGHBOURS, np.nan)))
    near = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1).copy()
    near[:, _NEIGHBOURS] = np.nan
    ordered = np.sort(np.where(np.isnan(near), -1.0, near), axis=1)  # the missing first, the fast last
    usual = ordered[:, -_DRAWS]
    # At the ends of a drive few steps are around: the fastest but one counts there.
    return np.asarray(np.where(usual < 0.0, np.maximum(ordered[:, -_DRAWS + 1], 0.0), usual), dtype=np.float64)

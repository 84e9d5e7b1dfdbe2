"""The game of two identical cars: points whose value is known, found by running optimal play backwards.

Merz (1972), The game of two identical cars; Mitchell (2001), Games of two identical vehicles. Relative coordinates of
the evader as the pursuer sees it. The barrier of the capture at a distance is where that distance is the smallest that
the evader can keep.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SPEED = RADIUS = 5.0
"""Speed of both cars [m/s], and the distance of capture [m]; both turn by up to 1 rad/s."""


def left_barrier(psi: float, radius: float = RADIUS, count: int = 400) -> tuple[Array, Array]:
    """Return points (2 count, 2) [m] of the barrier at a relative heading in [0, 2 pi], and their times (2 count,) [s].

    The pursuer turns left, the evader right: first those from which they do so until the evader grazes the circle, then
    those at whose end the pursuer, head on behind the evader, goes straight on for a while.
    """
    turning = np.linspace(0.0, psi / 2.0, count)
    end, still = psi - 2.0 * turning, np.zeros(count)
    grazing = np.array((radius * np.cos(end / 2.0), radius * np.sin(end / 2.0), end))
    straight = psi - 2.0 * turning[::-1]
    followed = _before(np.array((radius, 0.0, 0.0))[:, None], -1.0, straight)
    evader = np.concatenate((grazing, followed), axis=1)
    behind = np.array((-SPEED * straight, still, still))
    pursuer = np.concatenate((np.zeros_like(behind), behind), axis=1)
    times = np.concatenate((turning, turning[::-1]))
    ex, ey, _ = _before(evader, -1.0, times)
    px, py, heading = _before(pursuer, 1.0, times)
    cos, sin = np.cos(heading), np.sin(heading)
    points = np.column_stack((cos * (ex - px) + sin * (ey - py), cos * (ey - py) - sin * (ex - px)))
    return points, times + np.concatenate((still, straight))


def capture_outline(psi: float, radius: float = RADIUS, count: int = 400) -> tuple[Array, Array]:
    """Return the outline (N, 2) [m] of what cannot escape at a relative heading, and the times (N,) [s] to capture.

    It closes on the circle. Empty at headings at which the two barriers do not meet.
    """
    left, left_times = left_barrier(psi, radius, count)
    right, right_times = left_barrier(2.0 * np.pi - psi, radius, count)
    right = right * [1.0, -1.0]
    a, b = np.diff(left, axis=0)[:, None], np.diff(right, axis=0)[None]
    gap = right[None, :-1] - left[:-1, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        s = (gap[..., 0] * b[..., 1] - gap[..., 1] * b[..., 0]) / cross
        t = (gap[..., 0] * a[..., 1] - gap[..., 1] * a[..., 0]) / cross
    meets = np.argwhere((s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0))
    if not len(meets):
        return np.empty((0, 2)), np.empty(0)
    i, j = meets[0]
    points = np.concatenate((left[: i + 1], right[j::-1]))
    return points, np.concatenate((left_times[: i + 1], right_times[j::-1]))


def golden_points(radii: Sequence[float], headings: Sequence[float] | Array, horizon: float) -> tuple[Array, Array]:
    """Return states (N, 3) of the pursuer as the evader sees it, and their values (N,) [m]: least distance less RADIUS.

    Args:
        radii: Least distances [m].
        headings: Relative headings [rad].
        horizon: Longest time to the least distance [s].
    """
    states, values = [], []
    for psi in headings:
        for radius in radii:
            points, times = capture_outline(psi % (2.0 * np.pi), radius, 100)
            x, y = points[times < horizon].T
            c, s = np.cos(psi), np.sin(psi)
            states.append(np.column_stack((-(c * x + s * y), s * x - c * y, np.full(len(x), -psi))))
            values.append(np.full(len(x), radius - RADIUS))
    return np.concatenate(states), np.concatenate(values)


def _before(pose: Array, turn: float, time: Array) -> Array:
    """Return where a vehicle at x, y and heading (3, N) was that has turned at a rate for some time."""
    x, y, heading = np.broadcast_arrays(*pose, time)[:3]
    old = heading - turn * time
    x = x - SPEED / turn * (np.sin(heading) - np.sin(old))
    return np.array((x, y + SPEED / turn * (np.cos(heading) - np.cos(old)), old))

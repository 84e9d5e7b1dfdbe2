"""Two identical vehicles, one pursuing the other: the solver against the barrier of the game in closed form.

Merz (1972), The game of two identical cars; Mitchell (2001), Games of two identical vehicles. Relative coordinates of
the evader as the pursuer sees it: x' = -v + v cos psi + u y, y' = v sin psi - u x, psi' = d - u. The evader's speed and
turn are the second player's, so that the disturbance multiplies functions of the state.
"""

import numpy as np
import pytest
from matplotlib.path import Path

from ctrl_rl_core import Axis, Disc, Quantity, Region, System
from ttr_reward_node import TimeToReachProblem, solve

SPEED = RADIUS = 5.0


def air3d(counts):
    def equations(math, _p):
        return lambda x, u, d: (
            -SPEED + d[0] * math.cos(x[2]) + u[0] * x[1],
            d[0] * math.sin(x[2]) - u[0] * x[0],
            d[2] - u[0],
        )

    system = System(
        name="air3d",
        states=(Quantity("x", "m"), Quantity("y", "m"), Quantity("psi", "rad", -np.pi, np.pi, periodic=True)),
        controls=(Quantity("turn", "rad/s", -1.0, 1.0),),
        disturbances=(
            Quantity("d_v", "m/s", SPEED, SPEED),
            Quantity("d_y", "m/s", 0.0, 0.0),
            Quantity("d_turn", "rad/s", -1.0, 1.0),
        ),
        parameters={},
        equations=equations,
    )
    x, y, psi = counts
    axes = (Axis("x", "m", -6.0, 22.0, x), Axis("y", "m", -12.0, 12.0, y), Axis("psi", "rad", -np.pi, np.pi, psi, True))
    return TimeToReachProblem(system, axes, Region({}, Disc((0.0, 0.0), RADIUS)))


def before(x, y, heading, turn, time):
    """Where a vehicle was that has turned at a rate for some time."""
    old = heading - turn * time
    x = x - SPEED / turn * (np.sin(heading) - np.sin(old))
    return x, y + SPEED / turn * (np.cos(heading) - np.cos(old)), old


def left_barrier(psi, count=400):
    """Points (2 count, 2) of the barrier at a relative heading in [0, 2 pi]: the pursuer turns left, the evader right.

    First those from which they do so until the evader grazes the circle, then those at whose end the pursuer, head on
    behind the evader, goes straight on for a while.
    """
    turning = np.linspace(0.0, psi / 2.0, count)
    end, still = psi - 2.0 * turning, np.zeros(count)
    grazing = (RADIUS * np.cos(end / 2.0), RADIUS * np.sin(end / 2.0), end)
    straight = psi - 2.0 * turning[::-1]
    followed = before(RADIUS, 0.0, 0.0, -1.0, straight)
    evader = [np.concatenate(pair) for pair in zip(grazing, followed, strict=True)]
    pursuer = [np.concatenate((still, other)) for other in (-SPEED * straight, still, still)]
    times = np.concatenate((turning, turning[::-1]))
    ex, ey, _ = before(*evader, -1.0, times)
    px, py, heading = before(*pursuer, 1.0, times)
    cos, sin = np.cos(heading), np.sin(heading)
    return np.column_stack((cos * (ex - px) + sin * (ey - py), cos * (ey - py) - sin * (ex - px)))


def capture_set(psi):
    """The outline (N, 2) of what cannot escape at a relative heading, beside the target's circle."""
    left, right = left_barrier(psi), left_barrier(2.0 * np.pi - psi) * [1.0, -1.0]
    a, b = np.diff(left, axis=0)[:, None], np.diff(right, axis=0)[None]
    gap = right[None, :-1] - left[:-1, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        s = (gap[..., 0] * b[..., 1] - gap[..., 1] * b[..., 0]) / cross
        t = (gap[..., 0] * a[..., 1] - gap[..., 1] * a[..., 0]) / cross
    i, j = np.argwhere((s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0))[0]
    return np.concatenate((left[: i + 1], right[j::-1]))


@pytest.fixture(scope="module")
def solution():
    return solve(air3d((27, 24, 20)))


def test_no_more_is_captured_than_the_barrier_encloses(solution):
    """At headings about opposite, where the two barriers meet on the grid."""
    axes, values = solution.grid.axes, solution.grid.values
    points = np.stack(np.meshgrid(axes[0].nodes, axes[1].nodes, indexing="ij"), axis=-1)
    assert solution.converged
    nodes, wrong = 0, 0
    for k, heading in enumerate(axes[2].nodes % (2.0 * np.pi)):
        if abs(heading - np.pi) > 0.55:
            continue
        outline = capture_set(heading)
        captured = Path(outline).contains_points(points.reshape(-1, 2)).reshape(points.shape[:2])
        captured |= np.hypot(points[..., 0], points[..., 1]) <= RADIUS
        clear = np.linalg.norm(points[:, :, None] - outline, axis=-1).min(axis=-1) > 1.0
        nodes += clear.sum()
        wrong += (captured != np.isfinite(values[..., k]))[clear].sum()
    assert nodes > 1000
    assert wrong <= 0.01 * nodes


def test_left_and_right_are_alike(solution):
    values = solution.grid.values
    mirrored = values[:, ::-1, np.concatenate(([0], np.arange(19, 0, -1)))]
    assert np.mean(np.isfinite(values) != np.isfinite(mirrored)) < 0.002
    both = np.isfinite(values) & np.isfinite(mirrored)
    assert np.quantile(np.abs(values[both] - mirrored[both]), 0.99) < 0.01

"""Game of two identical vehicles: the solver against the closed-form barrier.

Merz (1972), The game of two identical cars; Mitchell (2001), Games of two identical vehicles. Coordinates of the evader
relative to the pursuer: x' = -v + v cos psi + u y, y' = v sin psi - u x, psi' = d - u. The evader's speed and turn rate
belong to the second player, so the disturbance multiplies functions of the state.
"""

import numpy as np
import pytest
from matplotlib.path import Path
from merz import RADIUS, SPEED, capture_outline

from ctrl_rl_core import Axis, Disc, Quantity, Region, System
from ttr_reward_node import TimeToReachProblem, solve


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


@pytest.fixture(scope="module")
def solution():
    return solve(air3d((41, 36, 30)))


def test_no_more_is_captured_than_the_barrier_encloses(solution):
    """Headings are about opposite, where the two barriers meet on the grid."""
    axes, values = solution.grid.axes, solution.grid.values
    points = np.stack(np.meshgrid(axes[0].nodes, axes[1].nodes, indexing="ij"), axis=-1)
    assert solution.converged
    nodes, wrong = 0, 0
    for k, heading in enumerate(axes[2].nodes % (2.0 * np.pi)):
        if abs(heading - np.pi) > 0.55:
            continue
        outline, _ = capture_outline(heading)
        captured = Path(outline).contains_points(points.reshape(-1, 2)).reshape(points.shape[:2])
        captured |= np.hypot(points[..., 0], points[..., 1]) <= RADIUS
        clear = np.linalg.norm(points[:, :, None] - outline, axis=-1).min(axis=-1) > 1.0
        nodes += clear.sum()
        wrong += (captured != np.isfinite(values[..., k]))[clear].sum()
    assert nodes > 1000
    assert wrong <= 0.01 * nodes


def test_left_and_right_are_alike(solution):
    values = solution.grid.values
    mirrored = values[:, ::-1, np.concatenate(([0], np.arange(29, 0, -1)))]
    assert np.mean(np.isfinite(values) != np.isfinite(mirrored)) < 0.002
    both = np.isfinite(values) & np.isfinite(mirrored)
    assert np.quantile(np.abs(values[both] - mirrored[both]), 0.99) < 0.01

"""Speeds from the motion of poses: exact on arcs, not across jumps, and only if the twist is missing."""

import numpy as np
import pytest
from ctrl_rl_core.sensing import lacks_twist, speeds_from_poses

NONE = np.empty(0, np.intp)


def arc(v: float, omega: float, count: int = 60, rate: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,) [ns] and poses (n, 3) of a drive at constant speeds with initial heading 3 rad."""
    t = np.arange(count) / rate
    yaw = 3.0 + omega * t
    if omega:
        x, y = v / omega * (np.sin(yaw) - np.sin(3.0)), v / omega * (np.cos(3.0) - np.cos(yaw))
    else:
        x, y = v * t * np.cos(3.0), v * t * np.sin(3.0)
    return np.round(1e9 * (5.0 + t)).astype(np.int64), np.column_stack((x, y, (yaw + np.pi) % (2 * np.pi) - np.pi))


@pytest.mark.parametrize(("v", "omega"), [(0.2, 0.0), (-0.1, 0.0), (0.2, 1.5), (0.0, -2.5)])
def test_speeds_are_those_of_the_drive(v: float, omega: float) -> None:
    times, poses = arc(v, omega)
    speeds = speeds_from_poses(times, poses, NONE)
    np.testing.assert_allclose(speeds[:, 0], v, atol=4e-3)  # a chord is a little shorter than its arc
    np.testing.assert_allclose(speeds[:, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(speeds[:, 2], omega, atol=1e-9)


def test_no_speed_reaches_across_a_jump_or_into_the_future() -> None:
    times, poses = arc(0.2, 0.0)
    poses[30:, :2] += 4.0
    np.testing.assert_allclose(speeds_from_poses(times, poses, np.array([30]))[:, 0], 0.2, atol=1e-9)
    stopped = np.minimum(np.arange(60), 40)
    speeds = speeds_from_poses(times, arc(0.2, 0.0)[1][stopped], NONE)[:, 0]
    np.testing.assert_allclose(speeds[:41], 0.2, atol=1e-9)
    np.testing.assert_allclose(speeds[43:], 0.0, atol=1e-9)


def test_a_twist_lacks_only_where_the_pose_moves_and_all_of_it_is_zero() -> None:
    times, poses = arc(0.2, 0.0)
    nothing = np.zeros((60, 2))
    assert lacks_twist(times, poses, nothing + 1e-12, NONE)
    assert lacks_twist(*arc(0.0, 1.0), nothing, NONE)
    once = nothing.copy()
    once[7, 0] = 0.01
    assert not lacks_twist(times, poses, once, NONE)
    standing = np.tile(poses[0], (60, 1)) + np.random.default_rng(0).normal(scale=0.005, size=(60, 3))
    assert not lacks_twist(times, standing, nothing, NONE)
    standing[30:, 0] += 1.0
    assert not lacks_twist(times, standing, nothing, np.array([30]))
    assert not lacks_twist(times[:0], poses[:0], nothing[:0], NONE)
    assert not len(speeds_from_poses(times[:0], poses[:0], NONE))

import numpy as np
import pytest
from sim_bridge.simulation.odometry import Localiser, correction


def test_errors_have_the_size_asked_for_and_vary_slowly():
    localiser = Localiser(0.05, 0.0524, rate=5.0, random=np.random.default_rng(1))
    errors = np.array([localiser.update(np.zeros(3)) for _ in range(20_000)])
    np.testing.assert_allclose(errors.std(axis=0), (0.05, 0.05, 0.0524), rtol=0.1)
    np.testing.assert_allclose(errors.mean(axis=0), 0.0, atol=0.01)
    steps = np.diff(errors, axis=0).std(axis=0)
    assert (steps < 0.35 * errors.std(axis=0)).all()  # 0.2 s are little of the 5 s in which they change
    np.testing.assert_allclose(localiser.covariance, (0.05**2, 0.05**2, 0.0524**2))


def test_without_errors_it_tells_the_truth():
    localiser = Localiser(0.0, 0.0, rate=5.0, random=np.random.default_rng(1))
    np.testing.assert_array_equal(localiser.update(np.array((1.0, -2.0, 0.5))), (1.0, -2.0, 0.5))


def test_a_correction_takes_odometry_to_the_pose_in_the_map():
    pose, odometry = np.array((2.0, 1.0, 2.5)), np.array((0.3, -0.7, -1.2))
    x, y, turn = correction(pose, odometry)
    c, s = np.cos(turn), np.sin(turn)
    moved = (x + c * odometry[0] - s * odometry[1], y + s * odometry[0] + c * odometry[1], odometry[2] + turn)
    assert moved == pytest.approx(tuple(pose))

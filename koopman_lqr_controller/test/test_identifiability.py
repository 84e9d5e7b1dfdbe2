"""A fit returns the true system or fails, with no third outcome, in any units and with any control."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from linear_drives import Array, Fit, distance, driven, plain, shrunk

from koopman_lqr_controller import KoopmanError, LinearModel, Snapshots, fit, solve_lqr

BOTH = pytest.mark.parametrize("fitted", [fit, shrunk])
SEEDS = st.integers(0, 2**31)


def some_system(random: np.random.Generator, n: int, m: int) -> LinearModel:
    A = random.normal(size=(n, n))
    return LinearModel(
        random.choice([0.5, 0.9, 1.0, 1.02]) * A / np.abs(np.linalg.eigvals(A)).max(), random.normal(size=(n, m))
    )


def in_units(data: Snapshots, d: Array, e: Array) -> Snapshots:
    return Snapshots(data.z * d, data.u * e, data.z_next * d)


def units(random: np.random.Generator, size: int) -> Array:
    return 10.0 ** random.uniform(-9.0, 9.0, size)


def told_or_refused(
    data: Snapshots, fitted: Fit, true: LinearModel, random: np.random.Generator, within: float = 1e-6
) -> bool:
    """Return whether a fit is correct, in any units; the test fails if it returns a wrong system."""
    d, e = units(random, len(true.A)), units(random, true.B.shape[1])
    try:
        found = fitted(in_units(data, d, e))
    except KoopmanError:
        return False
    assert distance(found, true, d, e) < within
    return True


@BOTH
@settings(deadline=None, max_examples=40)
@given(n=st.integers(1, 5), m=st.integers(1, 3), seed=SEEDS)
def test_controls_of_their_own_tell_the_system_in_any_units(fitted: Fit, n: int, m: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    true = some_system(random, n, m)
    data = driven(true, lambda _, __: random.normal(size=m), 200, random.normal(size=n))
    assert told_or_refused(data, fitted, true, random)


@pytest.mark.parametrize("fitted", [fit, plain, shrunk])
@settings(deadline=None, max_examples=40)
@given(n=st.integers(1, 5), m=st.integers(1, 3), power=st.floats(-14.0, 0.0), steps=st.integers(1, 200), seed=SEEDS)
def test_feedback_with_a_dither_of_any_size_is_told_or_refused(
    fitted: Fit, n: int, m: int, power: float, steps: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    true, K = some_system(random, n, m), 0.1 * random.normal(size=(m, n))
    data = driven(true, lambda _, z: -K @ z + 10.0**power * random.normal(size=m), steps, random.normal(size=n))
    told_or_refused(data, fitted, true, random, 1e-5)  # of a dither of 1e-8, 16 digits leave 8, and few rows fewer


@BOTH
@settings(deadline=None, max_examples=30)
@given(n=st.integers(1, 5), m=st.integers(1, 3), seed=SEEDS)
def test_feedback_alone_is_refused(fitted: Fit, n: int, m: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    true, K = some_system(random, n, m), 0.1 * random.normal(size=(m, n))
    data = driven(true, lambda _, z: -K @ z, 200, random.normal(size=n))
    with pytest.raises(KoopmanError, match=r"dither|together|never moves"):
        fitted(in_units(data, units(random, n), units(random, m)))


@settings(deadline=None, max_examples=40)
@given(n=st.integers(1, 5), power=st.floats(-3.0, 6.0), seed=SEEDS)
def test_states_around_an_offset_are_told_or_refused(n: int, power: float, seed: int) -> None:
    """A model of z + c has the drift (I - A) c, which `fit` cannot represent but `shrunk` can."""
    random = np.random.default_rng(seed)
    true, offset = some_system(random, n, 1), 10.0**power * random.normal(size=n)
    data = driven(true, lambda _, __: random.normal(size=1), 200, random.normal(size=n))
    moved = Snapshots(data.z + offset, data.u, data.z_next + offset)
    one = np.ones(n), np.ones(1)
    assert distance(shrunk(moved), true, *one) < 1e-6
    told_or_refused(moved, fit, true, random)
    assert distance(fit(moved.centred(offset, np.zeros(1))), true, *one) < 1e-6 * max(1.0, 10.0 ** (power - 3.0))


def test_a_position_far_from_the_origin_is_no_drift() -> None:
    true = LinearModel(np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]]))
    random = np.random.default_rng(0)
    data = driven(true, lambda _, __: random.normal(size=1), 300, np.array([1e6, 0.0]))
    assert distance(fit(data), true, np.ones(2), np.ones(1)) < 1e-6


@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("dither", [0.0, 1e-3, 1e-2, 1.0])
@BOTH
def test_a_regulator_of_noisy_feedback_stabilises_the_true_system_or_is_refused(
    fitted: Fit, noise: float, dither: float
) -> None:
    """Sensor noise looks like dither on a control that follows the sensors, but has no such effect."""
    true, K = LinearModel(np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])), np.array([[1.0, 1.5]])
    told = 0
    for seed in range(5):
        random = np.random.default_rng(seed)
        own = dither * random.normal(size=(300, 1))
        data = driven(true, lambda k, z, own=own: own[k] - K @ z, 300, np.array([1.0, 0.0]))  # type: ignore[misc]
        z = np.vstack((data.z, data.z_next[-1:]))
        z = z + noise * random.normal(size=z.shape)
        try:
            regulator = solve_lqr(fitted(Snapshots(z[:-1], data.u, z[1:])), np.eye(2), 0.01 * np.eye(1))
        except KoopmanError:
            continue
        told += 1
        assert np.abs(np.linalg.eigvals(true.A - true.B @ regulator.K)).max() < 1.0
    assert told == (5 if dither == 1.0 else 0) or 1e-3 <= dither <= 1e-2

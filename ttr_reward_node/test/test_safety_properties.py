"""Safety values decrease with horizon, obstacles and disturbance; warm and cold starts give the same result."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safety_cases import double_integrator

from ctrl_rl_core import Axis, Quantity, System
from ttr_reward_node import SafetyGame, SafetySolver

CASE = double_integrator(31)
QUICK = settings(max_examples=15, deadline=None, derandomize=True)
LINEAR = SafetySolver(CASE.game, interpolation="linear")


@QUICK
@given(short=st.integers(0, 20), more=st.integers(0, 20))
def test_more_time_is_never_safer(short, more):
    one, other = (LINEAR.solve(CASE.margin, horizon=n * LINEAR.step).values for n in (short, short + more))
    assert (other <= one + 1e-6).all()


@QUICK
@given(place=st.floats(-0.9, 0.9), width=st.floats(0.05, 0.3))
def test_more_obstacles_are_never_safer(place, width):
    x = CASE.game.axes[0].nodes[:, None]
    more = np.minimum(CASE.margin, np.abs(x - place) - width)
    one, other = (LINEAR.solve(margin, horizon=2.5).values for margin in (CASE.margin, more))
    assert (other <= one + 1e-6).all()


@QUICK
@given(weak=st.floats(0.0, 0.5), more=st.floats(0.0, 0.3))
def test_more_disturbance_is_never_safer(weak, more):
    games = (double_integrator(31, size).game for size in (weak, weak + more))
    one, other = (
        SafetySolver(game, step=0.1, interpolation="linear").solve(CASE.margin, horizon=2.5).values for game in games
    )
    assert (other <= one + 1e-6).all()


@QUICK
@given(seed=st.integers(0, 1000))
def test_the_discounted_form_ends_at_one_value_from_any_guess(seed):
    guess = np.random.default_rng(seed).uniform(-3.0, 3.0, CASE.margin.shape)
    options = {"discount": 1.0, "tolerance": 1e-5}
    cold, warm = LINEAR.solve(CASE.margin, **options), LINEAR.solve(CASE.margin, initial=guess, **options)
    assert cold.converged
    assert warm.converged
    np.testing.assert_allclose(warm.values, cold.values, atol=2e-3)
    assert (cold.values >= LINEAR.solve(CASE.margin).values - 1e-3).all()


@pytest.fixture(scope="module")
def car():
    """Return a robot that brakes at 1 m/s^2 along x and moves sideways at 0.3 m/s, in a window of 4 m by 4 m."""

    def equations(_math, _p):
        return lambda x, u, _d: (x[2], u[1], u[0])

    states = (Quantity("x", "m"), Quantity("y", "m"), Quantity("v", "m/s"))
    controls = (Quantity("a", "m/s^2", -1.0, 1.0), Quantity("aside", "m/s", -0.3, 0.3))
    none = tuple(Quantity(f"d_{name}", "1", 0.0, 0.0) for name in "xyv")
    axes = (Axis("x", "m", -2.0, 2.0, 41), Axis("y", "m", -2.0, 2.0, 41), Axis("v", "m/s", -1.0, 1.0, 11))
    return SafetySolver(SafetyGame(System("sidestepping", states, controls, none, {}, equations), axes))


def obstacle(x, y):
    """Return the distance to a disc of 0.4 m at (x, y), over the window [m]."""
    nodes = np.linspace(-2.0, 2.0, 41)
    return (np.hypot(nodes[:, None] - x, nodes[None] - y) - 0.4)[:, :, None]


def test_a_solution_is_a_fixed_point(car):
    first = car.solve(obstacle(0.4, 0.2))
    assert first.converged
    assert 0.5 < first.safe < 1.0
    again = car.solve(obstacle(0.4, 0.2), initial=first.values)
    assert again.steps == 1
    np.testing.assert_allclose(again.values, first.values, atol=2.0 * first.change)


def test_a_warm_start_ends_where_a_cold_one_does(car):
    """From above: the new obstacle makes the margin smaller."""
    old = car.solve(obstacle(0.4, 0.2))
    both = np.minimum(obstacle(0.4, 0.2), obstacle(-1.0, 0.8))
    cold, warm = car.solve(both), car.solve(both, initial=old.values)
    np.testing.assert_allclose(warm.values, cold.values, atol=0.01)
    assert warm.steps <= cold.steps


def test_a_warm_start_from_values_raised_as_the_margin_was_ends_where_a_cold_one_does(car):
    old, before, after = car.solve(obstacle(0.4, 0.2)), obstacle(0.4, 0.2), obstacle(0.3, -0.1)
    warm = car.solve(after, initial=old.values + (after - before).max())
    np.testing.assert_allclose(warm.values, car.solve(after).values, atol=0.01)


def test_no_beginning_makes_a_state_safe_that_is_not(car):
    cold = car.solve(obstacle(0.4, 0.2), tolerance=1e-5)
    guess = np.random.default_rng(0).uniform(-1.0, 3.0, cold.values.shape)
    warm = car.solve(obstacle(0.4, 0.2), initial=guess, tolerance=1e-5)
    assert warm.converged
    assert (warm.values <= cold.values + 0.01).all()


def test_a_grid_that_moves_has_the_values_of_a_new_one(car):
    old, margin = car.solve(obstacle(0.4, 0.2)), obstacle(0.0, 0.4)
    moved = car.shifted(old.values, (4, -2, 0), margin)
    np.testing.assert_array_equal(moved[:37, 2:], old.values[4:, :39])
    cold, warm = car.solve(margin), car.solve(margin, initial=moved)
    np.testing.assert_allclose(warm.values, cold.values, atol=0.01)
    assert warm.steps <= cold.steps

"""Bounded disturbance against the control (thesis Eq. 2.18-2.20): closed forms, and monotonicity in the disturbance."""

import numpy as np
import pytest
from games import double_integrator, line
from hypothesis import given, settings
from hypothesis import strategies as st

from ctrl_rl_core import Axis, Interval, Quantity, Region, System
from ttr_reward_node import TimeToReachProblem, solve


@pytest.mark.parametrize("disturbance", [0.0, 0.25, 0.6])
def test_line_has_the_speed_that_is_left(disturbance):
    problem = line(disturbance)
    expected = np.maximum(np.abs(problem.axes[0].nodes) - 0.25, 0.0) / (1.0 - disturbance)
    np.testing.assert_allclose(solve(problem).grid.values, expected, rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize(("method", "bound"), [("semi_lagrangian", 0.03), ("lax_friedrichs", 0.25)])
@pytest.mark.parametrize("disturbance", [0.0, 0.4])
def test_double_integrator_has_the_acceleration_that_is_left(disturbance, method, bound):
    """From x > 1/2 at full effective acceleration a towards the target: x + v t - a t^2 / 2 = 1/2."""
    grid = solve(double_integrator(disturbance, count=121), method).grid
    random = np.random.default_rng(0)
    x, v = random.uniform(0.6, 2.5, 2000), random.uniform(-2.5, 2.0, 2000)
    a = 1.0 - disturbance
    root = np.sqrt(v**2 + 2.0 * a * (x - 0.5))
    expected = (v + root) / a
    inside = (x + np.maximum(v, 0.0) ** 2 / (2.0 * a) < 2.5) & (root < 2.8)
    error = np.abs(grid.value(np.column_stack((x, v))) - expected)[inside]
    assert np.isfinite(error).all()
    assert np.median(error) < bound
    assert np.quantile(error, 0.99) < 4.0 * bound


def test_disturbance_as_strong_as_the_control_cannot_be_won_against():
    problem = line(1.0)
    outside = np.abs(problem.axes[0].nodes) > 0.45
    assert np.isinf(solve(problem).grid.values[outside]).all()


@settings(max_examples=15, deadline=None, derandomize=True)
@given(weak=st.floats(0.0, 0.7), more=st.floats(0.0, 0.2))
def test_stronger_disturbance_never_shortens_the_time(weak, more):
    one = solve(double_integrator(weak, count=31)).grid.values
    other = solve(double_integrator(weak + more, count=31)).grid.values
    assert (other[np.isinf(one)] == np.inf).mean() > 0.98 if np.isinf(one).any() else True
    both = np.isfinite(one) & np.isfinite(other)
    # Tolerance for the curvature, with which the scheme is not monotone.
    assert (other[both] >= one[both] - 0.05).all()


@pytest.mark.parametrize("gust", [0.0, 0.3])
@pytest.mark.parametrize("slow", [0.1, 0.01])
def test_an_axis_that_is_slow_beside_the_others_is_crossed(slow, gust):
    """Three independent axes, x far slower than the gust that acts on y: the slowest axis determines the time."""
    speeds = np.array([slow, 1.0, 0.6])
    bounds = np.array([0.0, gust, 0.0])
    system = System(
        name="three",
        states=tuple(Quantity(name, "m") for name in "xyz"),
        controls=tuple(Quantity(f"u_{name}", "1", -1.0, 1.0) for name in "xyz"),
        disturbances=tuple(Quantity(f"d_{name}", "m/s", -b, b) for name, b in zip("xyz", bounds.tolist(), strict=True)),
        parameters={},
        equations=lambda _m, _p: lambda _x, u, d: tuple(speeds[k] * u[k] + d[k] for k in range(3)),
    )
    axes = tuple(Axis(name, "m", -1.0, 1.0, 31) for name in "xyz")
    value = solve(TimeToReachProblem(system, axes, Region(dict.fromkeys("xyz", Interval(-0.15, 0.15))))).grid
    states = np.random.default_rng(0).uniform(-0.85, 0.85, (1000, 3))
    times = (np.maximum(np.abs(states) - 0.15, 0.0) / (speeds - bounds)).max(axis=1)
    found = value.value(states)
    assert np.isfinite(found).all()
    far = times > 0.3 / slow
    assert np.median(np.abs(found[far] - times[far]) / times[far]) < 0.06

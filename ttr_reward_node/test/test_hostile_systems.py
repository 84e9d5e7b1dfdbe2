"""Systems as a user may write them by mistake or in good faith: right, or refused in one line."""

import numpy as np
import pytest

from ctrl_rl_core import Axis, Interval, Quantity, Region, System
from ttr_reward_node import TimeToReachError, TimeToReachProblem, solve

X, Y = Quantity("x", "m"), Quantity("y", "m")
PUSH = Quantity("u", "m/s", -1.0, 1.0)
TURN = Quantity("theta", "deg", -180.0, 180.0, periodic=True)
RADIAN = np.pi / 180.0


def problem(rates, axes, target, states=(X,), controls=(PUSH,)):
    """Return the problem of x' = rates(math, x, u) on axes (lower, upper, count), to a box."""
    system = System(
        name="own",
        states=states,
        controls=controls,
        disturbances=tuple(Quantity(f"d_{s.name}", f"{s.unit}/s", 0.0, 0.0) for s in states),
        parameters={},
        equations=lambda math, _p: lambda x, u, _d: rates(math, x, u),
    )
    grid = tuple(Axis(s.name, s.unit, *a, s.periodic) for s, a in zip(states, axes, strict=True))
    return TimeToReachProblem(system, grid, Region({name: Interval(*each) for name, each in target.items()}))


def car(rates):
    """Return the problem of a car whose heading is in degrees."""
    axes = (-4.0, 4.0, 41), (-4.0, 4.0, 41), (-180.0, 180.0, 36)
    return problem(
        rates, axes, {"x": (-0.4, 0.4), "y": (-0.4, 0.4)}, (X, Y, TURN), (Quantity("w", "rad/s", -1.0, 1.0),)
    )


def test_a_gear_that_switches_at_a_place():
    """x' = u, four times as fast beyond 0.013: long steps leap over the switch, and were 5 % too short."""
    one = problem(lambda _m, x, u: (u[0] * (1 + 3 * (x[0] > 0.013)),), [(-1.0, 1.0, 41)], {"x": (0.5, 0.6)})
    assert one.jump == "x"
    times = solve(one).grid.value([[-0.5], [1.0]])
    np.testing.assert_allclose(times, [0.513 + 0.487 / 4.0, 0.1], rtol=0.015)


def test_a_ditch_of_mud():
    """At a fifth of the speed within 0.31 of the middle: times were 13 % too short."""

    def slowed(_m, x, u):
        share = 1.0 - 0.8 * (abs(x[1]) < 0.31)
        return u[0] * share, u[1] * share

    axes, target = [(-1.0, 1.0, 41)] * 2, {"x": (-0.1, 0.1), "y": (0.8, 0.9)}
    two = problem(slowed, axes, target, (X, Y), (PUSH, Quantity("w", "m/s", -1.0, 1.0)))
    assert two.jump == "y"
    times = solve(two).grid.value([[0.0, -0.8], [0.0, 0.0]])
    np.testing.assert_allclose(times, [0.49 + 3.1 + 0.49, 1.55 + 0.49], rtol=0.02)


def test_steep_and_bent_derivatives_do_not_jump():
    for shape in (lambda m, x: m.tanh(20.0 * x), lambda m, x: m.sqrt(abs(x)), lambda _m, x: abs(x), lambda _m, x: x**3):
        smooth = problem(lambda m, x, u, f=shape: (u[0] + f(m, x[0]),), [(-1.0, 1.0, 41)], {"x": (0.5, 0.6)})
        assert smooth.jump == ""


def test_degrees_are_a_unit_like_others():
    degrees = car(lambda m, x, u: (m.cos(x[2] * RADIAN), m.sin(x[2] * RADIAN), u[0] / RADIAN))
    (time,) = solve(degrees, certify=False).grid.value([[-3.0, 0.0, 0.0]])
    assert time == pytest.approx(2.6, abs=0.05)


@pytest.mark.fault
@pytest.mark.parametrize(
    "rates",
    [
        lambda m, x, u: (m.cos(x[2]), m.sin(x[2]), u[0] / RADIAN),  # cos of degrees
        lambda _m, x, u: (x[2], 0.0 * x[1], u[0]),  # counts turns
    ],
)
def test_a_derivative_that_differs_one_turn_on_is_refused(rates):
    with pytest.raises(TimeToReachError, match=r"'theta' is periodic, but the derivative of 'x' is .* sin and cos"):
        car(rates)


@pytest.mark.fault
def test_equations_that_change_what_they_are_given_are_refused():
    def doubles(_m, x, u):
        speed = x[1]
        speed *= 2.0
        return speed, u[0]

    with pytest.raises(TimeToReachError, match=r"f must not change x, u or d: write y = 2 \* x\[0\]"):
        problem(doubles, [(-1.0, 1.0, 41)] * 2, {"x": (-0.1, 0.1)}, (X, Y))


def test_five_coarse_axes_are_told():
    names = [Quantity(name, "m") for name in ("x", "v", "y", "w", "z")]
    controls = [Quantity(f"a{k}", "1", -1.0, 1.0) for k in range(3)]
    five = problem(
        lambda _m, x, u: (x[1], u[0], x[3], u[1], u[2]),
        [(-2.0, 2.0, 8)] * 5,
        {each.name: (-0.6, 0.6) for each in names},
        names,
        controls,
    )
    assert "solve with more nodes, first along " in solve(five).certificate.grid

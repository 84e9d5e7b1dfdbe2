"""Dependences found from a system's equations: never fewer than finite differences at random points show."""

import operator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ttr_reward_node.problems.dependence import AFFINE, dependences
from ttr_reward_node.solvers.steps import make_layout

from ctrl_rl_core import SYSTEM_MODELS, Axis, Interval, Quantity, Region, System, make_system
from ttr_reward_node import TimeToReachError, TimeToReachProblem, solve

NAMES = ("x", "y", "w")
SAMPLES = 200


def make(equations, controls=2, bound=1.0, parameters=None):
    """Return a system of three states with disturbances within +-`bound` on each derivative."""
    return System(
        name="made",
        states=tuple(Quantity(name, "m") for name in NAMES),
        controls=tuple(Quantity(f"u_{i}", "m/s", -1.0, 1.0) for i in range(controls)),
        disturbances=tuple(Quantity(f"d_{name}", "m/s", -bound, bound) for name in NAMES),
        parameters=parameters or {},
        equations=equations,
    )


LEAVES = st.one_of(
    st.tuples(st.sampled_from("xd"), st.integers(0, 2)),
    st.tuples(st.just("u"), st.integers(0, 1)),
    st.tuples(st.just("number"), st.sampled_from([0.0, 0.5, -2.0, np.float64(3.0)])),
)


def deeper(inner):
    both = st.tuples(st.sampled_from(["add", "sub", "mul", "truediv"]), inner, inner)
    return st.one_of(both, st.tuples(st.sampled_from(["sin", "cos", "tan", "neg", "square"]), inner))


TREES = st.recursive(LEAVES, deeper, max_leaves=12)


def value(tree, math, x, u, d):
    """Return the value of an expression."""
    kind, *inner = tree
    if kind in ("x", "u", "d"):
        return {"x": x, "u": u, "d": d}[kind][inner[0]]
    if kind == "number":
        return inner[0]
    parts = [value(part, math, x, u, d) for part in inner]
    if kind == "neg":
        return -parts[0]
    if kind == "square":
        return parts[0] ** 2
    if kind == "truediv":
        return parts[0] / (parts[1] * parts[1] + 1.0)
    return getattr(operator, kind)(*parts) if len(parts) == 2 else getattr(math, kind)(parts[0])


def rates(system, x, u, d):
    with np.errstate(all="ignore"):
        return np.broadcast_to(np.nan_to_num(system.dynamics(x, u, d)), x.shape)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(trees=st.tuples(TREES, TREES, TREES), seed=st.integers(0, 1000))
def test_no_dependence_is_missed(trees, seed):
    system = make(lambda math, _: lambda x, u, d: tuple(value(tree, math, x, u, d) for tree in trees))
    found, random = dependences(system), np.random.default_rng(seed)
    inputs = [random.uniform(-1.0, 1.0, (SAMPLES, size)) for size in (3, 2, 3)]
    before = rates(system, *inputs)
    for kind, (values, field) in enumerate(zip(inputs, ("states", "controls", "disturbances"), strict=True)):
        for k in range(values.shape[1]):
            other = [array.copy() for array in inputs]
            other[kind][:, k] = random.uniform(-1.0, 1.0, SAMPLES)
            changed = ~np.isclose(rates(system, *other), before, rtol=1e-9, atol=1e-9).all(axis=0)
            for rate in np.flatnonzero(changed):
                assert k in getattr(found[rate], field), trees[rate]
    # Affine: the mean of disturbances gives the mean of the rates. Uncoupled: their effect is the same at any control.
    x, u, d = inputs
    other_u, other_d = random.uniform(-1.0, 1.0, u.shape), random.uniform(-1.0, 1.0, d.shape)
    mean = 0.5 * (before + rates(system, x, u, other_d))
    bent = ~np.isclose(rates(system, x, u, 0.5 * (d + other_d)), mean, rtol=1e-6, atol=1e-6).all(axis=0)
    effect = before - rates(system, x, u, other_d)
    elsewhere = rates(system, x, other_u, d) - rates(system, x, other_u, other_d)
    coupled = ~np.isclose(effect, elsewhere, rtol=1e-6, atol=1e-6).all(axis=0)
    for rate in range(3):
        assert not bent[rate] or found[rate].disturbance_degree > AFFINE, trees[rate]
        assert not coupled[rate] or found[rate].coupled, trees[rate]


@pytest.mark.parametrize("name", SYSTEM_MODELS)
def test_systems_of_the_thesis_are_affine_and_additive(name):
    names = [f"d_{state.name}" for state in SYSTEM_MODELS[name].states]
    system = make_system(name, disturbance_bounds=dict.fromkeys(names, (-0.1, 0.1)))
    for k, rate in enumerate(dependences(system)):
        assert rate.disturbances == {k}
        assert rate.disturbance_degree == 1
        assert rate.control_degree <= AFFINE
        assert not rate.coupled


def test_what_is_held_or_multiplied_by_zero_does_not_count():
    def equations(_math, p):
        return lambda x, u, d: (p["drag"] * x[1] + u[0], d[1] * x[2], x[0] - 0.0 * x[1])

    one, two, three = dependences(make(equations, bound=0.0, parameters={"drag": 0.0}))
    assert (one.states, one.controls) == (set(), {0})
    assert (two.states, two.disturbances) == (set(), set())
    assert three.states == {0}
    with_wind = dependences(make(equations, bound=1.0, parameters={"drag": 0.5}))
    assert [rate.states for rate in with_wind] == [{1}, {2}, {0}]
    free = dependences(make_system("dubins_car"), hold=False)
    assert [rate.controls for rate in free] == [{0}, {0}, {1}]


def test_equations_that_ask_for_a_value_depend_on_everything():
    def equations(_math, _p):
        return lambda x, u, d: (u[0] if x[2] > 1.0 else d[0], u[1], 0.0)

    for rate in dependences(make(equations)):
        assert rate.states == {0, 1, 2}
        assert rate.coupled


def problem(equations, bound=0.5):
    axes = tuple(Axis(name, "m", -1.0, 1.0, 5) for name in NAMES)
    return TimeToReachProblem(make(equations, bound=bound), axes, Region({"x": Interval(-0.2, 0.2)}))


def test_a_disturbance_that_multiplies_a_state_is_seen():
    layout = make_layout(problem(lambda _m, _p: lambda x, u, d: (u[0] + d[0] * x[1], u[1] + d[1], x[2] * 0.0 + d[2])))
    assert layout.outer == (1,)
    assert layout.inner == (0, 2)


@pytest.mark.parametrize(
    ("equations", "words"),
    [
        (lambda _m, _p: lambda _x, u, d: (u[0], d[1] * d[1], u[1]), "'y' more than linearly"),
        (lambda math, _p: lambda _x, u, d: (u[0] + math.sin(d[0]), u[1], 0.0), "'x' more than linearly"),
        (lambda _m, _p: lambda _x, u, d: (u[0], u[1], u[1] * d[2]), "'w' control and disturbance together"),
    ],
)
def test_a_game_that_vertices_do_not_solve_is_refused(equations, words):
    with pytest.raises(TimeToReachError, match=words):
        problem(equations)
    assert problem(equations, bound=0.0).system.name == "made"


def test_lax_friedrichs_refuses_controls_that_are_not_affine():
    bent = problem(lambda _m, _p: lambda _x, u, _d: (u[0] * u[0], u[1], 0.0), bound=0.0)
    with pytest.raises(TimeToReachError, match="use semi_lagrangian, with more samples"):
        solve(bent, "lax_friedrichs")

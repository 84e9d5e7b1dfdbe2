"""Invalid problems, digests of problems, and every system model from a task file."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from games import double_integrator, line, plane
from hypothesis import given
from hypothesis import strategies as st
from ttr_reward_node.cli.values import solve_value

from ctrl_rl_core import SYSTEM_MODELS, Axis, Disc, Interval, Region, make_system, task_file
from ttr_reward_node import Clearance, SafetyGame, TimeToReachError, TimeToReachProblem, load_value, roll_out, solve


def write_task(folder, name, **changes):
    """Write the car's task under another name with some keys replaced; None removes a key."""
    content = yaml.safe_load(task_file("car_ttr").read_text(encoding="utf-8"))
    content.update(name=name, **changes)
    file = folder / f"{name}.yaml"
    left = {key: value for key, value in content.items() if value is not None}
    file.write_text(yaml.safe_dump(left, sort_keys=False), encoding="utf-8")
    return str(file)


def small_grid(model):
    """Return a grid with five nodes per axis, eight if periodic, over the state's bounds or else -2 to 2."""
    grid, goal = {}, {}
    for state in SYSTEM_MODELS[model].states:
        low, high = (
            (max(state.lower, -2.0), min(state.upper, 2.0)) if not state.periodic else (state.lower, state.upper)
        )
        if model == "quadrotor_rotation" and state.name == "theta":
            low, high = -1.0, 1.0  # singular when pointing straight up
        grid[state.name] = {"interval": f"{low} .. {high} {state.unit}", "count": 8 if state.periodic else 5}
        goal[state.name] = f"{low / 2.0} .. {high / 2.0} {state.unit}"
    return {"grid": grid, "goal": goal}


@pytest.mark.parametrize("model", SYSTEM_MODELS)
def test_every_system_is_solved_from_a_task_file(model, tmp_path):
    names = [state.name for state in SYSTEM_MODELS[model].states]
    flies = "z" in names and "y" not in names
    arena = {"x": "-3.0 .. 3.0 m", ("z" if flies else "y"): "-3.0 .. 3.0 m", "wall_thickness": "0.2 m"}
    task = write_task(
        tmp_path, "own", system={"model": model}, arena=arena, start={}, obstacles=None, **small_grid(model)
    )
    file = tmp_path / "own.safetensors"
    assert solve_value(["--task", task, "--output", str(file)]) == 0
    value = load_value(file)
    assert value.state_names == tuple(names)
    assert 0.0 < value.grids[0].values[np.isfinite(value.grids[0].values)].max() < 100.0


COARSE = ["--count", "x=21", "y=21", "theta=16"]


@pytest.mark.fault
@pytest.mark.parametrize(
    ("goal", "words"),
    [
        ({"x": "13.7 .. 14.3 m", "y": "3.7 .. 4.3 m"}, "'x' in [13.7, 14.3] m, outside the grid's [-5, 5]"),
        ({"disc": {"centre": "(0, 9) m", "radius": "1 m"}}, "'y' in [8, 10] m, outside the grid's [-5, 5]"),
        ({"x": "-0.2 .. 0.2 m", "y": "-0.2 .. 0.2 m"}, "walls or obstacles cover it, widened by 0 m"),
        ({"x": "-5 .. 5 m"}, "nothing outside the goal reaches it"),
    ],
)
def test_a_goal_that_nothing_reaches_fails(goal, words, tmp_path, capsys):
    task, file = write_task(tmp_path, "own", goal=goal), tmp_path / "own.safetensors"
    assert solve_value(["--task", task, *COARSE, "--output", str(file)]) == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not file.exists()


def test_walls_of_another_plane_are_refused(tmp_path, capsys):
    arena = {"x": "-3.0 .. 3.0 m", "z": "-3.0 .. 3.0 m", "wall_thickness": "0.2 m"}
    task = write_task(tmp_path, "own", arena=arena)
    assert solve_value(["--task", task, *COARSE, "--output", str(tmp_path / "own.safetensors")]) == 1
    assert "walls and obstacles lie in x and z; the positions of dubins_car are x, y" in capsys.readouterr().err


NUMBERS = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-4.0, 4.0))


@given(low=NUMBERS, high=NUMBERS)
def test_a_target_is_an_interval_on_the_grid_or_refused(low, high):
    """The axis ranges from -3 to 3."""
    right = math.isfinite(low) and math.isfinite(high) and low <= high and high >= -3.0 and low <= 3.0
    if right:
        assert replace(line(), target=Region({"x": Interval(low, high)})).target.intervals["x"] == (low, high)
    else:
        with pytest.raises(TimeToReachError, match="'x' in"):
            replace(line(), target=Region({"x": Interval(low, high)}))


@pytest.mark.fault
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"target": Region({"q": Interval(0.0, 1.0)})}, "the target bounds 'q'; the states are x, y"),
        ({"target": Region({}, Disc((0.0, math.nan), 1.0))}, "disc of radius 1 m: give finite numbers"),
        ({"target": Region({}, Disc((0.0, 0.0), -1.0))}, "disc of radius -1 m"),
        ({"inflation": math.nan}, "inflation is nan m"),
        ({"corridor_width": -1.0}, "corridor_width is -1 m"),
        ({"digest": "mine"}, "the digest is 'mine'"),
        ({"clearance": Clearance((0, 1), np.full((41, 41), np.nan, np.float32))}, "clearance is NaN or infinite"),
        ({"clearance": Clearance((0, 1), np.full((41, 41), np.inf, np.float32))}, "clearance is NaN or infinite"),
        ({"clearance": Clearance((0, 1), np.zeros((4, 4), np.float32))}, "the clearance has shape"),
    ],
)
def test_what_makes_no_sense_is_refused(changes, words):
    with pytest.raises(TimeToReachError, match=words):
        replace(plane(), **changes)


def test_controls_within_bounds_that_are_none_are_refused():
    system = line().system
    for pair in ((1.0, -1.0), (math.nan, 1.0), (0.0, math.inf)):
        wrong = replace(system, controls=(replace(system.controls[0], lower=pair[0], upper=pair[1]),))
        with pytest.raises(TimeToReachError, match="'u_0' is in"):
            replace(line(), system=wrong)


def test_the_digest_tells_obstacles_apart():
    problem: TimeToReachProblem = plane()
    assert problem.digest == ""
    free = problem.content_digest
    walls = [plane(lambda x, _y, at=at: np.abs(x - at) - 0.15).content_digest for at in (0.5, 0.6)]
    assert len({free, *walls}) == 3
    # Digest in files of earlier versions.
    assert free == "176f7e9ba7ad106c3a48ed698b7beb830c3c20b7cdb19263c22f6ca5a0cfecd0"
    moved = replace(problem, target=Region({"x": Interval(-1.6, -1.2)}))
    assert moved.content_digest != free
    assert replace(problem, digest="0" * 64).content_digest == "0" * 64


def bounded_cart(low=-1.0, high=1.0):
    """Return a cart with bounds on its speed, on a grid to +-2 m/s."""
    cart = double_integrator().system
    return TimeToReachProblem(
        system=replace(cart, states=(cart.states[0], replace(cart.states[1], lower=low, upper=high))),
        axes=(Axis("x", "m", -6.0, 6.0, 61), Axis("v", "m/s", -2.0, 2.0, 41)),
        target=Region({"x": Interval(-0.2, 0.2), "v": Interval(-0.2, 0.2)}),
    )


def test_the_states_own_bounds_limit_it_within_the_grid():
    cart, free = bounded_cart(), bounded_cart(-math.inf, math.inf)
    assert cart.limits.tolist() == [[-6.0, -1.0], [6.0, 1.0]]
    assert free.limits.tolist() == [[-6.0, -2.0], [6.0, 2.0]]
    assert cart.outside()[0].tolist() == (np.abs(cart.axes[1].nodes) > 1.0).tolist()
    assert not free.outside().any()
    # Only bounds tighter than the grid take effect.
    assert bounded_cart(-2.0, 9.0).content_digest == free.content_digest != cart.content_digest
    with pytest.raises(TimeToReachError, match=r"'v' in \[1.5, 1.8\] m/s, outside the state's own bounds, \[-1, 1\]"):
        replace(cart, target=Region({"v": Interval(1.5, 1.8)}))


def test_the_grid_of_a_safety_game_ends_within_the_states_bounds():
    cart = bounded_cart()
    with pytest.raises(TimeToReachError, match=r"'v' stays in \[-1, 1\], but its axis goes beyond"):
        SafetyGame(cart.system, cart.axes)


def test_lax_friedrichs_keeps_to_the_states_bounds():
    values = solve(bounded_cart(), "lax_friedrichs").grid
    assert np.isinf(values.values[:, np.abs(values.axes[1].nodes) > 1.01]).all()
    # From rest at 4 m, the free cart takes slightly less than 4 s; limited to 1 m/s, 5 s.
    assert 4.6 < values.value([[4.0, 0.0]])[0] < 5.6


def test_a_roll_out_that_leaves_the_states_bounds_has_left():
    free = solve(bounded_cart(-math.inf, math.inf)).grid
    outcome = roll_out(free, bounded_cart(), [[4.0, 0.0], [0.7, 0.0]])
    assert outcome.left.tolist() == [True, False]
    assert outcome.reached.tolist() == [False, True]


def turning(lower, upper, count=16, periodic=True):
    """Return the car with the given axis for its heading."""
    axes = (
        Axis("x", "m", -2.0, 2.0, 9),
        Axis("y", "m", -2.0, 2.0, 9),
        Axis("theta", "rad", lower, upper, count, periodic),
    )
    return TimeToReachProblem(make_system("dubins_car"), axes, Region({"x": Interval(-0.5, 0.5)}))


@pytest.mark.fault
@pytest.mark.parametrize(
    ("ends", "periodic", "words"),
    [
        (
            (-math.pi / 2, math.pi / 2),
            True,
            "is 3.14159 rad long, but the state's period is 6.28319: give one period",
        ),
        ((-180.0, 180.0), True, "it seems to be in degrees: give one period"),
        ((0.0, 180.0), False, "it seems to be in degrees: give one period"),
        ((0.0, 4.0 * math.pi), True, "is 12.5664 rad long"),
        ((-4.0, 4.0), False, "is 8 rad long"),
    ],
)
def test_an_axis_that_goes_round_another_way_than_the_state_is_refused(ends, periodic, words):
    with pytest.raises(TimeToReachError, match=words):
        turning(*ends, periodic=periodic)


def test_a_heading_may_have_an_axis_that_it_must_not_leave():
    turning(0.0, 2.0 * math.pi)
    turning(-3.1416, 3.1416)
    assert turning(-1.0, 1.0, periodic=False).limits[:, 2].tolist() == [-1.0, 1.0]
    # A car with a limited heading cannot return from behind.
    whole, half = turning(-math.pi, math.pi, 24), turning(-math.pi / 2, math.pi / 2, 13, periodic=False)
    assert np.isfinite(solve(whole).grid.value([[1.0, 0.0, 0.0]])[0])
    assert np.isinf(solve(half).grid.value([[1.0, 0.0, 0.0]])[0])


@pytest.mark.fault
def test_too_few_nodes_to_carry_a_step_are_refused():
    with pytest.raises(TimeToReachError, match=r"axis 'theta' has 7 nodes, .* give at least 8"):
        turning(-math.pi, math.pi, 7)
    with pytest.raises(TimeToReachError, match=r"axis 'x' has 4 nodes, .* give at least 5"):
        line(count=4)
    turning(-math.pi, math.pi, 8)
    # Nothing moves along the second axis: it is a constant parameter.
    still = double_integrator().system
    still = replace(still, equations=lambda _m, _p: lambda x, u, d: (u[0] + d[0], 0.0 * x[1]))
    axes = (Axis("x", "m", -3.0, 3.0, 61), Axis("v", "m/s", 0.0, 1.0, 2))
    solved = solve(TimeToReachProblem(still, axes, Region({"x": Interval(-0.5, 0.5)}))).grid
    np.testing.assert_allclose(solved.value([[2.0, 0.3]]), 1.5, atol=0.02)

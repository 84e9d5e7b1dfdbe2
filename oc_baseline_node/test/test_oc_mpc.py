"""Trajectories against closed forms and the task, with the real solvers."""

from dataclasses import replace

import numpy as np
import pytest
from oc_baseline_node.mpc.initial_guess import equilibrium_control
from oc_baseline_node.mpc.transcription import Layout, stage_cost
from scipy.linalg import solve_discrete_are

from ctrl_rl_core import NavigationTask, Outcome, Region, TaskSets, load_navigation_task, make_system, signed_distance
from oc_baseline_node import (
    Mpc,
    MpcSolution,
    OptimalControlProblem,
    RecedingHorizon,
    draw_start,
    formulate,
    shift_trajectory,
)

TASKS = ("car_navigation", "quad_navigation", "quad_trap")
AT_REST = {
    "car_navigation": (-4.0, -4.0, 1.0),
    "quad_navigation": (3.75, 0.0, 2.0, 0.0, 0.0, 0.0),
    "quad_trap": (0.0, 0.0, 4.0, 0.0, 0.0, 0.0),
}


@pytest.fixture(scope="module")
def mpcs() -> dict[str, Mpc]:
    return {name: Mpc(formulate(load_navigation_task(name))) for name in TASKS}


def linear_problem(horizon: int, gamma: float) -> OptimalControlProblem:
    """Return a point mass without obstacles: linear dynamics, quadratic cost, no active bounds."""
    base = formulate(load_navigation_task("car_navigation"))
    bounds = dict.fromkeys(("v_x", "v_y", "v_z"), (-1000.0, 1000.0))
    free = np.array([[-np.inf] * 3, [np.inf] * 3])
    return replace(
        base,
        system=make_system("point_mass", control_bounds=bounds),
        horizon=horizon,
        gamma=gamma,
        terminal=Region(),
        obstacles=(),
        state_bounds=free,
    )


@pytest.mark.parametrize("solver", ["ipopt", "fatrop"])
def test_a_linear_quadratic_problem_has_its_least_squares_solution(solver: str) -> None:
    problem = linear_problem(horizon=15, gamma=1.1)
    start, dt, H = np.array([1.0, -2.0, 0.5]), problem.time_step, problem.horizon
    trajectory = Mpc(problem, (solver,)).solve(start)
    assert trajectory.solved, trajectory.reason
    for axis in (0, 1):
        # p_k = p_0 + dt * (u_0 + ... + u_{k-1}): the cost is |A u - b|^2.
        weight = np.sqrt(problem.state_weight * problem.gamma ** np.arange(1, H + 1))
        A = np.vstack((weight[:, None] * dt * np.tri(H, H, -1), np.sqrt(problem.control_weight) * np.eye(H)))
        b = np.concatenate((weight * (problem.goal[axis] - start[axis]), np.zeros(H)))
        u = np.linalg.lstsq(A, b, rcond=None)[0]
        assert trajectory.controls[:, axis] == pytest.approx(u, abs=1e-4)
    assert trajectory.controls[:, 2] == pytest.approx(np.zeros(H), abs=1e-6)


def test_a_long_horizon_has_the_gain_of_the_riccati_equation() -> None:
    problem = linear_problem(horizon=200, gamma=1.0)
    start, dt = np.array([1.0, -2.0, 0.0]), problem.time_step
    P = solve_discrete_are(np.eye(2), dt * np.eye(2), problem.state_weight * np.eye(2), np.eye(2))
    K = np.linalg.solve(np.eye(2) + dt * P * dt, dt * P)
    trajectory = Mpc(problem).solve(start)
    error = start[:2] - np.array(problem.goal)
    assert trajectory.controls[0, :2] == pytest.approx(-K @ error, rel=1e-4)
    assert trajectory.cost == pytest.approx(float(error @ P @ error), rel=1e-4)


def check(problem: OptimalControlProblem, trajectory: MpcSolution, start: np.ndarray) -> None:
    """Check a trajectory independently of the solver."""
    states, controls = trajectory.states, trajectory.controls
    x = np.asarray(start, dtype=float)
    for k, u in enumerate(controls):
        x = problem.system.step(x, u, dt=trajectory.time_step)
        assert x == pytest.approx(states[k + 1], abs=2e-3), f"step {k}"
    points = states[1:, problem.positions]
    assert signed_distance(problem.obstacles, points).min() >= problem.clearance - 1e-4
    low, high = problem.state_bounds
    assert (states[1:] >= low - 1e-4).all()
    assert (states[1:] <= high + 1e-4).all()
    u_low, u_high = problem.system.control_bounds
    assert (controls >= u_low - 1e-4).all()
    assert (controls <= u_high + 1e-4).all()
    outcomes = TaskSets(problem.task).outcomes(states)
    assert outcomes[-1] == Outcome.GOAL
    assert not (outcomes[1:] == Outcome.COLLISION).any()
    p = states[:-1, problem.positions]
    cost = sum(stage_cost(problem, p[k], controls[k], k) for k in range(problem.horizon))
    assert trajectory.cost == pytest.approx(cost * trajectory.time_step / problem.time_step, rel=1e-6)


@pytest.mark.parametrize("name", TASKS)
def test_every_trajectory_keeps_what_the_problem_asks(mpcs: dict[str, Mpc], name: str) -> None:
    mpc, random = mpcs[name], np.random.default_rng(3)
    starts = [np.array(AT_REST[name]), *(draw_start(mpc.problem, random) for _ in range(6))]
    solved = 0
    for start in starts:
        trajectory = mpc.solve(start)
        if trajectory.solved:
            check(mpc.problem, trajectory, start)
            solved += 1
    assert solved >= 6


def test_ipopt_and_fatrop_find_the_same_trajectory() -> None:
    problem = formulate(short_car(60))
    costs = [Mpc(problem, (solver,)).solve((1.5, 4.0, 0.0)).cost for solver in ("ipopt", "fatrop")]
    assert costs[0] == pytest.approx(costs[1], rel=1e-4)


def test_a_warm_start_takes_fewer_iterations(mpcs: dict[str, Mpc]) -> None:
    mpc = mpcs["car_navigation"]
    cold = mpc.solve(AT_REST["car_navigation"])
    warm = mpc.solve(cold.states[1], shift_trajectory(cold.states, cold.controls, 1))
    again = mpc.solve(cold.states[1])
    assert warm.solved
    assert warm.iterations < again.iterations
    assert warm.cost <= again.cost * (1 + 1e-3)


def short_car(horizon: int = 140) -> NavigationTask:
    """The car with the published time step: at most 7 s in total."""
    task = load_navigation_task("car_navigation")
    assert task.optimal_control is not None
    changed = task.optimal_control.model_copy(update={"time_step": 0.05, "horizon": horizon})
    return task.model_copy(update={"optimal_control": changed})


@pytest.mark.parametrize("form", ["free_time", "letter"])
def test_the_other_forms_keep_the_speed(form: str) -> None:
    problem = formulate(short_car(), form)
    trajectory = Mpc(problem).solve((1.0, 3.5, 0.0) if form == "free_time" else (-1.9, 0.0, 0.5))
    assert trajectory.solved, trajectory.reason
    assert (trajectory.controls[:, 0] == 1.0).all()
    check(problem, trajectory, trajectory.states[0])
    if form == "letter":
        assert trajectory.time_step == 0.05
    else:
        assert 0.01 - 1e-6 <= trajectory.time_step < 0.05


def test_a_start_without_a_trajectory_gets_a_reason_and_no_traceback(mpcs: dict[str, Mpc]) -> None:
    car = mpcs["car_navigation"]
    assert "0.35 m inside an obstacle" in car.solve((0.0, 0.0, 0.0)).reason
    assert "x = 4.9 is out of bounds" in car.solve((4.9, 0.0, 0.0)).reason
    assert "3 finite numbers" in car.solve((np.nan, 0.0, 0.0)).reason
    assert "3 finite numbers" in car.solve((0.0, 0.0)).reason
    falling = mpcs["quad_trap"].solve((0.0, 0.0, 0.6, -2.0, 0.0, 0.0))
    assert not falling.solved
    assert falling.reason == "ipopt: Infeasible_Problem_Detected"
    assert np.isnan(falling.cost)
    far = Mpc(formulate(short_car(20), "letter")).solve((-4.5, -4.5, 0.0))
    assert not far.solved, "1 s at 1 m/s do not lead 11 m away"
    assert far.reason.startswith("ipopt: ")


def test_the_receding_horizon_drives_the_car_to_the_goal(mpcs: dict[str, Mpc]) -> None:
    mpc = mpcs["car_navigation"]
    sets, controller = TaskSets(mpc.problem.task), RecedingHorizon(mpc)
    state = np.array([1.0, -2.5, 1.5])
    for _ in range(100):
        state = mpc.problem.system.step(state, controller.control(state), dt=mpc.problem.time_step)
        outcome = sets.outcomes(state)
        assert outcome != Outcome.COLLISION
        if outcome == Outcome.GOAL:
            break
    assert outcome == Outcome.GOAL


def test_without_a_trajectory_the_controller_follows_its_plan_and_says_so() -> None:
    controller = RecedingHorizon(Mpc(formulate(short_car(40))))
    in_a_wall = (9.0, 9.0, 0.0)
    assert controller.control(in_a_wall) == pytest.approx([0.0, 0.0])
    assert not controller.solved
    controller.control((2.0, 2.0, 0.5))
    assert controller.solved
    plan = controller.plan
    assert controller.control(in_a_wall) == pytest.approx(plan.controls[1])
    assert controller.control(in_a_wall) == pytest.approx(plan.controls[2])
    assert not controller.solved
    assert controller.reason


def test_the_resting_control_hovers(mpcs: dict[str, Mpc]) -> None:
    system = mpcs["quad_trap"].problem.system
    u = equilibrium_control(system)
    assert u == pytest.approx([1.25 * 9.81 / 2] * 2)
    assert system.dynamics(np.zeros(6), u) == pytest.approx(np.zeros(6))


@pytest.mark.parametrize("form", ["free_speed", "free_time", "letter"])
def test_packing_is_undone_by_unpacking(form: str) -> None:
    problem = formulate(short_car(), form)
    layout, random = Layout(problem), np.random.default_rng(0)
    states = random.normal(size=(problem.horizon + 1, 3))
    controls = random.normal(size=(problem.horizon, 2))
    if form != "free_speed":
        controls[:, 0] = 1.0
    time_step = 0.03 if form == "free_time" else 0.05
    variables = layout.pack(states, controls, time_step)
    assert variables.shape == (layout.size,)
    for ours, theirs in zip(layout.unpack(variables), (states, controls, time_step), strict=True):
        assert np.array_equal(ours, theirs)

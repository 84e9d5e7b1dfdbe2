"""Quadratic programs from a nearby trajectory: against a dense solver, and against the interior-point cost."""

from dataclasses import replace

import casadi
import numpy as np
import pytest
from oc_baseline_node.mpc.solution import TOLERANCE, violated_constraint
from oc_baseline_node.mpc.stage_qp import solve_stages

from ctrl_rl_core import load_navigation_task
from oc_baseline_node import Mpc, RecedingHorizon, draw_start, formulate, shift_trajectory

STATES, CONTROLS, STAGES, ROWS = 3, 2, 6, 2
WIDTH = STATES + CONTROLS


def random_stages(random: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return H, q, A, b, lower, upper, G, c and the first state of a feasible program."""
    root = random.normal(size=(STAGES + 1, WIDTH, WIDTH))
    H = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(WIDTH)
    q, b = random.normal(size=(STAGES + 1, WIDTH)), random.normal(size=(STAGES, STATES))
    A = 0.4 * random.normal(size=(STAGES, STATES, WIDTH))
    first = random.normal(size=STATES)
    inside = np.zeros((STAGES + 1, WIDTH))
    inside[0, :STATES] = first
    for k in range(STAGES):
        inside[k, STATES:] = random.uniform(-0.5, 0.5, CONTROLS)
        inside[k + 1, :STATES] = A[k] @ inside[k] + b[k]
    lower, upper = inside - random.uniform(0.01, 1.0, inside.shape), inside + random.uniform(0.01, 1.0, inside.shape)
    lower[0, :STATES], upper[0, :STATES] = -np.inf, np.inf
    lower[-1, STATES:], upper[-1, STATES:] = -np.inf, np.inf
    upper[2] = np.inf
    G = random.normal(size=(STAGES + 1, ROWS, WIDTH))
    G[-1, :, STATES:] = 0.0
    c = random.uniform(0.01, 1.0, (STAGES + 1, ROWS)) - np.einsum("krw,kw->kr", G, inside)
    c[1, 0] = np.inf
    return H, q, A, b, lower, upper, G, c, first


def densely(H, q, A, b, lower, upper, G, c, first) -> np.ndarray:
    """Return the solution by ipopt, without use of the stage structure."""
    z = casadi.SX.sym("z", (STAGES + 1) * WIDTH)
    part = [z[k * WIDTH : (k + 1) * WIDTH] for k in range(STAGES + 1)]
    stages = range(STAGES)
    cost = sum(0.5 * casadi.bilin(H[k], part[k], part[k]) + casadi.dot(q[k], part[k]) for k in stages)
    last = part[-1][:STATES]
    cost += 0.5 * casadi.bilin(H[-1][:STATES, :STATES], last, last) + casadi.dot(q[-1][:STATES], last)
    g = [
        part[0][:STATES] - first,
        *(part[k + 1][:STATES] - casadi.DM(A[k]) @ part[k] - b[k] for k in stages),
        part[-1][STATES:],
    ]
    equal = sum(each.numel() for each in g)
    rows = [casadi.DM(G[k]) @ part[k] for k in range(STAGES + 1)]
    program = {"x": z, "f": cost, "g": casadi.vertcat(*g, *rows)}
    solver = casadi.nlpsol("dense", "ipopt", program, {"ipopt": {"print_level": 0, "tol": 1e-10}, "print_time": False})
    low = np.concatenate((np.zeros(equal), -c.ravel()))
    high = np.concatenate((np.zeros(equal), np.full(c.size, np.inf)))
    return np.asarray(solver(lbx=lower.ravel(), ubx=upper.ravel(), lbg=low, ubg=high)["x"]).reshape(STAGES + 1, WIDTH)


@pytest.mark.parametrize("seed", range(10))
def test_a_program_of_stages_has_the_solution_of_a_dense_one(seed: int) -> None:
    stages = random_stages(np.random.default_rng(seed))
    iterations, z, *_ = solve_stages(*stages, 0.0, 1e-10, 1.0, 1e2)
    assert iterations > 0
    expected = densely(*stages)
    assert z[:-1] == pytest.approx(expected[:-1], abs=1e-4)
    assert z[-1, :STATES] == pytest.approx(expected[-1, :STATES], abs=1e-4)


def test_a_program_that_nothing_meets_and_one_without_a_minimum_are_told() -> None:
    H, q, A, b, lower, upper, G, c, first = random_stages(np.random.default_rng(0))
    assert solve_stages(H, q, A, b, lower, upper, G, np.full_like(c, -1e3), first, 0.0, 1e-9, 1e-2, 1.0)[0] == 0
    free = np.full_like(lower, np.inf)
    assert solve_stages(-H, q, A, b, -free, free, G, free[:, :ROWS], first, 0.0, 1e-9, 1e-2, 1.0)[0] == -1


@pytest.mark.parametrize("name", ["car_navigation", "quad_navigation", "quad_trap"])
def test_one_step_on_it_costs_what_the_interior_point_finds(name: str) -> None:
    problem, random = formulate(load_navigation_task(name)), np.random.default_rng(1)
    mpc, interior_point = Mpc(problem), Mpc(problem, nearby=False)
    plans = [mpc.solve(draw_start(mpc.problem, random)) for _ in range(8)]
    nearby = 0
    for plan in (each for each in plans if each.solved):
        guess, start = shift_trajectory(plan.states, plan.controls, 1), plan.states[1]
        for multipliers in (None, mpc.shift(plan.multipliers, 1)):
            warm, cold = mpc.solve(start, guess, multipliers=multipliers), interior_point.solve(start, guess)
            assert warm.solved, warm.reason
            assert warm.cost <= cold.cost + 0.01 * abs(cold.cost)
            assert violated_constraint(mpc.problem, start, warm.states, warm.controls, warm.time_step) == ""
            nearby += warm.reason == "sqp: solved"
    assert nearby >= 8


@pytest.mark.parametrize("form", ["free_time", "letter"])
def test_the_other_forms_start_warm_too(form: str) -> None:
    task = load_navigation_task("car_navigation")
    changed = task.optimal_control.model_copy(update={"time_step": 0.05, "horizon": 60})
    mpc = Mpc(formulate(task.model_copy(update={"optimal_control": changed}), form))
    plan = mpc.solve((1.0, 3.5, 0.0) if form == "free_time" else (1.2, 2.4, 0.5))
    assert plan.solved, plan.reason
    nudged = plan.states[0] + np.array([0.0, 0.005, 0.01])
    warm = mpc.solve(nudged, (plan.states, plan.controls), multipliers=plan.multipliers)
    assert warm.solved, warm.reason
    assert warm.cost == pytest.approx(mpc.solve(nudged).cost, rel=0.01)


def test_what_leads_nowhere_is_left_to_the_interior_point() -> None:
    mpc = Mpc(formulate(load_navigation_task("car_navigation")))
    start, H = np.array([-4.0, -4.0, 1.0]), mpc.problem.horizon
    nonsense = np.random.default_rng(0).normal(size=(H + 1, 3)), np.zeros((H, 2))
    found = mpc.solve(start, nonsense)
    assert not found.reason.startswith("sqp")
    lost = mpc.solve(start, (np.full((H + 1, 3), np.nan), np.zeros((H, 2))))
    assert not lost.solved
    assert "nan" in lost.reason


def test_a_disturbed_car_is_steered_by_quadratic_programs_alone() -> None:
    mpc, random = Mpc(formulate(load_navigation_task("car_navigation"))), np.random.default_rng(0)
    controller, state, reasons = RecedingHorizon(mpc), np.array([1.0, -2.5, 1.5]), []
    for _ in range(30):
        u = controller.control(state)
        assert controller.solved, controller.reason
        reasons.append(controller.reason)
        assert controller.plan.states[0] == pytest.approx(state, abs=TOLERANCE)
        state = mpc.problem.system.step(state, u, dt=mpc.problem.time_step) + random.normal(scale=0.003, size=3)
    assert reasons[0].startswith("fatrop")
    assert reasons[1:].count("sqp: solved") >= 25


def test_the_state_costs_growth_does_not_matter_to_it() -> None:
    problem = formulate(load_navigation_task("car_navigation"))
    for gamma in (1.0, 1.2):
        mpc = Mpc(replace(problem, gamma=gamma))
        plan = mpc.solve((3.0, -3.0, 1.0))
        warm = mpc.solve(plan.states[1], shift_trajectory(plan.states, plan.controls, 1))
        assert warm.reason == "sqp: solved"

"""From an RL task to an optimal control problem: candidates, criteria, constants."""

from dataclasses import replace

import numpy as np
import pytest
from oc_baseline_node.problems.extraction import CANDIDATES, assess, rl_info

from ctrl_rl_core import Interval, NavigationTask, Outcome, Region, TaskSets, load_navigation_task
from oc_baseline_node import OcError, extract, formulate


def test_the_car_is_a_dubins_car_as_in_the_thesis() -> None:
    found = extract(load_navigation_task("car_navigation"))
    assert found.info.robot_type == "car"
    assert found.info.state[:3] == ("x", "y", "theta")
    assert found.info.state[3:] == tuple(f"d_{i}" for i in range(1, 9))
    assert found.chosen == "dubins_car"
    refused = {candidate.model: candidate.reasons for candidate in found.candidates}
    assert set(refused) == set(CANDIDATES["car"])
    assert refused["dubins_car"] == ()
    assert "delta" in refused["bicycle"][0]


@pytest.mark.parametrize("name", ["quad_navigation", "quad_trap"])
def test_the_quadrotor_is_the_planar_one_as_in_the_thesis(name: str) -> None:
    found = extract(load_navigation_task(name))
    assert found.chosen == "planar_quadrotor"
    reasons = {candidate.model: " ".join(candidate.reasons) for candidate in found.candidates}
    assert "criterion 1" in reasons["quadrotor_rotation"]
    assert "criterion 2: the reward's 'goal' needs psi" in reasons["point_mass"]


def test_a_reward_on_what_the_model_lacks_refuses_it() -> None:
    task = load_navigation_task("car_navigation")
    goal = task.goal.model_copy(update={"intervals": {"v": task.optimal_control.controls["v"]}})
    info = rl_info(task.model_copy(update={"goal": goal}))
    told = replace(info, state=(*info.state, "v", "omega"))  # as a learner that is told its speeds
    assert assess("extended_dubins_car", told).reasons == ()
    (reason,) = assess("dubins_car", told).reasons
    assert reason == "criterion 2: the reward's 'goal' needs v, which it lacks"
    assert "criterion 1: its v, omega are not in the RL state" in assess("extended_dubins_car", info).reasons[0]


def test_the_report_names_every_part() -> None:
    report = extract(load_navigation_task("quad_trap")).report()
    for words in ("quadrotor", "d_1 .. d_8", "+100 trap", "refused, criterion 1", "p_trap = (-2.5, 0.5)", "1.1^(k+1)"):
        assert words in report


@pytest.mark.parametrize(
    ("name", "words"), [("quad_ttr", "has no part 'optimal_control'"), ("car_ttr", "has no part 'optimal_control'")]
)
def test_a_task_without_what_it_takes_is_refused(name: str, words: str) -> None:
    with pytest.raises(OcError, match=words):
        extract(load_navigation_task(name))


@pytest.mark.parametrize("name", ["car_navigation", "quad_navigation", "quad_trap"])
def test_a_state_within_the_constraints_is_not_in_collision(name: str) -> None:
    problem = formulate(load_navigation_task(name))
    sets = TaskSets(problem.task)
    low, high = np.where(np.isfinite(problem.state_bounds), problem.state_bounds, [[-3.0], [3.0]])
    states = low + (high - low) * np.random.default_rng(0).random((5000, len(low)))
    allowed = states[problem.margin(states) >= 0.0]
    assert len(allowed) > 2000
    assert not (sets.outcomes(allowed) == Outcome.COLLISION).any()


@pytest.mark.parametrize("name", ["car_navigation", "quad_navigation", "quad_trap"])
def test_the_terminal_set_lies_within_the_goal(name: str) -> None:
    problem = formulate(load_navigation_task(name))
    sets, random = TaskSets(problem.task), np.random.default_rng(0)
    ends = np.array([problem.terminal.sample(problem.system.state_names, random) for _ in range(500)])
    free = ends[problem.margin(ends) >= 0.0]
    assert len(free) > 100
    assert (sets.outcomes(free) == Outcome.GOAL).all()
    assert all(problem.terminal_violation(state) <= 0.0 for state in ends)


def test_the_trap_form_has_the_trap_and_the_others_have_none() -> None:
    assert formulate(load_navigation_task("quad_trap")).trap_weight == 1000.0
    assert formulate(load_navigation_task("quad_navigation")).trap is None


def test_forms_differ_in_the_speed() -> None:
    task = load_navigation_task("car_navigation")
    assert formulate(task).system.control_bounds[:, 0].tolist() == [-0.8, 2.0]
    for form in ("letter", "free_time"):
        assert formulate(task, form).system.control_bounds[:, 0].tolist() == [1.0, 1.0]
    with pytest.raises(OcError, match="no form 'other'"):
        formulate(task, "other")  # type: ignore[arg-type]


def test_a_clearance_that_leaves_no_room_is_refused() -> None:
    with pytest.raises(OcError, match="no state is 6 m from the walls"):
        formulate(load_navigation_task("car_navigation"), clearance=6.0)


def test_terminal_set_and_goal_that_do_not_meet_are_refused() -> None:
    task = load_navigation_task("quad_trap")
    spec = task.optimal_control
    apart = task.start.model_copy(update={"intervals": {"psi": type(task.arena.x)(-1.0, -0.5)}})
    assert isinstance(apart.region, Region)
    update = {"optimal_control": spec.model_copy(update={"terminal_set": apart})}
    with pytest.raises(OcError, match="do not meet in 'psi'"):
        formulate(task.model_copy(update=update))


def changed_car(**optimal_control: object) -> NavigationTask:
    """Return the car's task with some constants of its optimal control problem replaced."""
    task = load_navigation_task("car_navigation")
    assert task.optimal_control is not None
    return task.model_copy(update={"optimal_control": task.optimal_control.model_copy(update=optimal_control)})


def test_a_control_that_is_left_out_keeps_the_tasks_own_bounds() -> None:
    problem = formulate(changed_car(controls={"v": Interval(0.0, 0.5)}))
    assert problem.system.control_bounds.T.tolist() == [[0.0, 0.5], [-2.0, 2.0]]
    assert problem.sources == ("optimal_control.controls", "system.controls")
    bare = changed_car(controls={})
    system = bare.system.model_copy(update={"controls": {"omega": "-0.3 .. 0.3 rad/s"}})
    problem = formulate(bare.model_copy(update={"system": system}))
    assert problem.system.control_bounds.T.tolist() == [[1.0, 1.0], [-0.3, 0.3]]
    assert problem.sources[0] == "the model's own bounds, as the task names none"


def test_a_state_cost_that_grows_beyond_numbers_is_refused() -> None:
    for gamma, horizon in ((10.0, 10_000), (2.0, 1000), (1.5, 700)):
        with pytest.raises(OcError, match=r"gamma\^horizon = .* take a gamma nearer to 1"):
            formulate(changed_car(gamma=gamma, horizon=horizon))


def test_bounds_of_the_tasks_system_hold_for_trajectories() -> None:
    task = load_navigation_task("quad_navigation")
    system = task.system.model_copy(update={"states": {"v_x": "-0.5 .. 0.5 m/s"}})
    problem = formulate(task.model_copy(update={"system": system}))
    index = problem.system.state_names.index("v_x")
    assert problem.state_bounds[:, index].tolist() == [-0.5, 0.5]
    assert np.isinf(formulate(task).state_bounds[:, index]).all()

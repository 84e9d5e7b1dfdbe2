"""A system of one's own: a package offers it, and solver, MPC, simulator and training take it from a task."""

import sys
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_core.systems import find_model
from ctrl_rl_learning.sb3 import FleetEnvironments, evaluate_in_fleet, extract_actor, make_algorithm

from ctrl_rl_core import (
    SYSTEM_MODELS,
    Outcome,
    PolicyError,
    SystemModelError,
    TaskError,
    interface_of,
    load_navigation_task,
    task_digest,
)
from oc_baseline_node import extract
from sim_bridge import NavigationEnv, PlanarFleet, SimulationError, SimulationOptions
from ttr_reward_node import TimeToReach, problem_from_task, solve

FOLDER = Path(__file__).resolve().parents[1] / "examples" / "own_robot"


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install the example's package as pip does, for this process; return a function that changes the entry point."""
    monkeypatch.setattr(sys, "path", [str(tmp_path), str(FOLDER), *sys.path])  # pip leaves its own offer there
    own = tmp_path / "own_robot-0.1.0.dist-info"
    own.mkdir()
    (own / "METADATA").write_text("Metadata-Version: 2.1\nName: own-robot\nVersion: 0.1.0\n")

    def offer(value="tricycle:TRICYCLE"):
        (own / "entry_points.txt").write_text(f"[ctrl_rl.systems]\ntricycle = {value}\n")

    offer()
    yield offer
    SYSTEM_MODELS.pop("tricycle", None)
    sys.modules.pop("tricycle", None)


@pytest.fixture
def task(installed):  # noqa: ARG001
    """Return the example's task."""
    return load_navigation_task(FOLDER / "tricycle_yard.yaml")


def test_the_time_to_reach_grows_with_the_way(task):
    counts = {"x": 21, "y": 15, "theta": 16, "delta": 5}
    value = TimeToReach(solve(problem_from_task(task, counts=counts, inflation=0.2)).grid)
    near, far = value.times(np.array([(1.2, -1.0, 0.0, 0.0), (-2.2, -1.0, 0.0, 0.0)]))
    assert 1.0 < near < 4.0  # 0.6 m at 0.6 m/s, on coarse nodes
    assert far > near + 5.0


def test_the_mpc_problem_has_its_states_and_controls(task):
    problem = extract(task).problem
    assert problem.system.state_names == ("x", "y", "theta", "delta")
    assert problem.system.control_names == ("v", "delta_rate")


def test_a_robot_moves_as_its_equations_say_alone_and_in_a_fleet(task):
    single = NavigationEnv(task, options=SimulationOptions(rate=30))
    fleet = PlanarFleet(task, size=2)
    fleet.begin(0, 3)
    observation, info = single.reset(seed=3)
    state = info["state"]
    np.testing.assert_allclose(fleet.observations()[0], observation, atol=1e-5)
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (40, 2)):
        observation, reward, terminated, _, info = single.step(action)
        outcomes = fleet.step(np.tile(action, (2, 1)))
        command = (0.15 + 0.45 * action[0], 1.5 * action[1])
        for _ in range(6):
            state = task.system.build().step(state, command, dt=1 / 30)
            state[3] = np.clip(state[3], -0.6, 0.6)
        np.testing.assert_allclose(info["state"][[0, 1, 3]], state[[0, 1, 3]], atol=1e-9)
        np.testing.assert_allclose(fleet.states()[0], info["state"], atol=1e-9)
        np.testing.assert_allclose(fleet.observations()[0], observation, atol=1e-5)
        assert (Outcome(outcomes[0]).name, fleet.rewards()[0]) == (info["outcome"], reward)
        if terminated:
            break
    single.close()


def test_a_policy_is_learnt_and_driven(task):
    model = make_algorithm("ppo", FleetEnvironments(task, 8), 0, 2048)
    model.learn(2048)
    (episode,) = evaluate_in_fleet(extract_actor(model, task, {}), task, [0])
    assert episode.states.shape[1] == 4
    with pytest.raises(PolicyError, match="no node can send v and delta_rate"):
        interface_of(task)


def test_an_engine_of_contacts_is_refused(task):
    with pytest.raises(SimulationError, match="does not simulate bodies with their own equations: use engine planar"):
        NavigationEnv(task, options=SimulationOptions(engine="mujoco"))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("tricycle:NOTHING", r"system 'tricycle' \(tricycle:NOTHING\) cannot be loaded"),
        (
            "tricycle:equations",
            r"system 'tricycle' \(tricycle:equations\) is no ctrl_rl_core\.systems\.models\.SystemModel",
        ),
    ],
)
def test_an_offer_that_is_none_is_said(installed, value, message):
    installed(value)
    with pytest.raises(SystemModelError, match=message):
        find_model("tricycle")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("footprint: 0.2 m", "tilt_limit: 1 rad", "footprint: is the radius of a body 'model'"),
        (
            "delta_rate: -1.5 .. 1.5 rad/s}\n\narena",
            "omega: -1.5 .. 1.5 rad/s}\n\narena",
            "must be the two controls of",
        ),
        ("model: tricycle", "model: bicycle", "must be the two controls of|no such name|has no control"),
    ],
)
@pytest.mark.usefixtures("installed")
def test_a_model_that_does_not_suit_its_task_is_said(tmp_path, old, new, message):
    text = (FOLDER / "tricycle_yard.yaml").read_text()
    assert old in text
    (tmp_path / "tricycle_yard.yaml").write_text(text.replace(old, new))
    with pytest.raises(TaskError, match=message):
        load_navigation_task(tmp_path / "tricycle_yard.yaml")


def test_tasks_of_the_suite_keep_their_digests():
    assert task_digest(load_navigation_task("car_ttr")).startswith("afbf5877e78f2c46")

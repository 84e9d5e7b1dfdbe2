"""Learning with the real library in the real simulator: it resumes exactly, and its policies need no torch."""

import json
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from ctrl_rl_core.outcome import Outcome
from ctrl_rl_core.tasks import load_navigation_task
from ttr_reward_node.actor import Actor
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.rewards import make_reward
from ttr_reward_node.training import Cell, Options, evaluate, result_file, train_one
from ttr_reward_node.training_algorithms import ALGORITHMS, ROLL_OUT, extract_actor, make_algorithm
from ttr_reward_node.training_environment import make_environment
from ttr_reward_node.training_matrix import MatrixOptions, cells, run_matrix
from ttr_reward_node.training_results import collect, samples_to
from ttr_reward_node.training_visits import load_visits

SHORT = {"iterations": 2, "samples": ROLL_OUT, "evaluations": 1, "final_evaluations": 2}


class CutOffError(Exception):
    """Stands for a kill between two iterations."""


def cut_off(*_):
    """A report that ends the run."""
    raise CutOffError


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_run_that_was_cut_off_ends_as_if_it_had_not_been(tmp_path, algorithm):
    cell = Cell("quad_ttr", algorithm, "distance_1", 3)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    train_one(cell, Options(whole, **SHORT))
    with pytest.raises(CutOffError):
        train_one(cell, Options(cut, **SHORT, report=cut_off))
    assert not result_file(cut, cell).exists()
    train_one(cell, Options(cut, **SHORT))

    def learnt(folder):
        result = json.loads(result_file(folder, cell).read_text(encoding="utf-8"))
        for point in result["curve"]:
            del point["seconds"]
        return result

    assert learnt(cut) == learnt(whole)
    one, other = (Actor.load(folder / str(cell) / "policy.safetensors") for folder in (whole, cut))
    assert all(np.array_equal(a, b) for a, b in zip(one.weights, other.weights, strict=True))
    counts = load_visits(cut / str(cell) / "visits.safetensors")
    assert counts["places"].shape[0] == 2
    assert counts["turns"].sum(axis=1).tolist() == [ROLL_OUT, ROLL_OUT]


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_deployed_policy_acts_like_the_learnt_one(tmp_path, algorithm):
    task = load_navigation_task("quad_ttr")
    reward = make_reward("sparse", task)
    model = make_algorithm(algorithm, lambda: make_environment(reward), 0, ROLL_OUT)
    file = tmp_path / "policy.safetensors"
    extract_actor(model, task, {"task": task.name}).save(file)
    actor = Actor.load(file)
    environment = make_environment(reward)
    observation, _ = environment.reset(seed=1)
    for _ in range(5):
        expected, _ = model.predict(observation, deterministic=True)
        assert actor.scaled_action(observation) == pytest.approx(expected, abs=1e-5)
        observation, *_ = environment.step(expected)
    raw = environment.unwrapped
    command = actor.command(raw._observation())
    low, high = np.array(list(task.robot.commands.values())).T
    assert (command >= low - 1e-5).all()
    assert (command <= high + 1e-5).all()
    environment.close()
    model.env.close()


def test_the_wrapper_pays_the_reward_and_leaves_the_rest_alone():
    task = load_navigation_task("car_ttr")
    reward = make_reward("distance_10", task)
    environment = make_environment(reward)
    bare = gymnasium.make("sim_bridge.environments:ctrl_rl/car_ttr-v0", options=environment.unwrapped.world.options)
    scaled, _ = environment.reset(seed=4)
    observation, _ = bare.reset(seed=4)
    for _ in range(20):
        wrapper = environment.env
        assert scaled == pytest.approx((observation - environment.middle) / environment.unit, abs=1e-5)
        action = np.array([1.0, 0.3], dtype=np.float32)
        scaled, paid, terminated, truncated, info = environment.step(action)
        observation, own, bare_terminated, bare_truncated, _ = bare.step(action)
        assert (terminated, truncated) == (bare_terminated, bare_truncated)
        if terminated or truncated:
            assert paid == own
            break
        assert paid == pytest.approx(reward(info["state"][None], [Outcome.RUNNING])[0])
        assert isinstance(wrapper, gymnasium.Wrapper)
    assert terminated, "drives into something within 4 s"
    environment.close()
    bare.close()


def test_evaluations_are_the_same_for_all():
    task = load_navigation_task("quad_ttr")
    reward = make_reward("sparse", task)
    model = make_algorithm("ppo", lambda: make_environment(reward), 0, ROLL_OUT)
    actor = extract_actor(model, task, {})
    environment = make_environment(reward)
    first, second = (evaluate(actor, environment, 2, 7) for _ in range(2))
    for (outcome, states), (again, same) in zip(first, second, strict=True):
        assert outcome == again
        assert np.array_equal(states, same)
    environment.close()
    model.env.close()


def test_the_matrix_runs_on_several_cores_and_is_collected(tmp_path):
    options = MatrixOptions(
        "quad_ttr", tmp_path, algorithms=("ppo",), rewards=("sparse",), seeds=2, iterations=1, samples=ROLL_OUT
    )
    results = run_matrix(options)
    assert [result["cell"]["seed"] for result in results] == [0, 1]
    rows, figures = collect(options)
    assert [row.metric for row in rows][:1] == ["success"]
    assert len(rows[0].values) == 2
    assert np.array(figures["curves"]["ppo, sparse"]["success"]).shape == (2, 1)
    assert np.sum(figures["visits"]["ppo, sparse"]["turns"]) == 2 * ROLL_OUT
    before = [result_file(tmp_path, cell).stat().st_mtime_ns for cell in cells(options)]
    run_matrix(options)
    assert before == [result_file(tmp_path, cell).stat().st_mtime_ns for cell in cells(options)]


def test_learnt_means_good_twice():
    curve = [{"samples": 10 * k, "evaluation": success} for k, success in enumerate((0.0, 0.95, 0.5, 0.9, 1.0), 1)]
    assert samples_to(curve) == 40.0
    assert samples_to(curve[:3]) is None


def test_a_broken_checkpoint_is_named(tmp_path):
    cell = Cell("quad_ttr", "ppo", "sparse", 0)
    checkpoint = tmp_path / str(cell) / "checkpoint.safetensors"
    checkpoint.parent.mkdir()
    checkpoint.write_bytes(b"half a file")
    with pytest.raises(TimeToReachError, match=r"checkpoint\.safetensors: cannot go on from it .* delete it"):
        train_one(cell, Options(tmp_path, **SHORT))


def test_a_file_that_is_no_policy_is_named(tmp_path):
    file = tmp_path / "policy.safetensors"
    with pytest.raises(TimeToReachError, match="policy"):
        Actor.load(file)
    file.write_bytes(b"{}")
    with pytest.raises(TimeToReachError, match="cannot be read as a policy"):
        Actor.load(file)


def test_the_deployed_policy_needs_no_torch():
    program = "import sys, ttr_reward_node.actor; sys.exit('torch' in sys.modules or 'gymnasium' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0

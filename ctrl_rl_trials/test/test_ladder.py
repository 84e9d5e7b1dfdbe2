"""Tests of the ladder: its tasks, what a step pays, one short training of each way, its file."""

import math

import numpy as np
import pytest
from ctrl_rl_core.io import read_experiment
from ctrl_rl_trials.ladder.results import read_curves, write
from ctrl_rl_trials.ladder.runs import LadderRun
from ctrl_rl_trials.ladder.task_list import LADDER, PRACTICE, load_ladder_task
from ctrl_rl_trials.shaping import baseline
from ctrl_rl_trials.shaping.variants import WAYS
from hypothesis import given
from hypothesis import strategies as st
from ttr_reward_node.rewards import PER_SECOND, BestProgress, Progress, Shaping

from ctrl_rl_core import Result, ResultsError, task_digest
from sim_bridge import SimulatedWorld, SimulationOptions
from ttr_reward_node import problem_from_task, solve

LONGEST = 20.0
TIMES = st.lists(st.floats(0.0, LONGEST) | st.just(math.inf), min_size=2, max_size=30)


def total(pay, times):
    """Return what an episode with these times to reach (n,) pays."""
    pay.begin(times[0])
    return sum(pay.step(seconds, False) for seconds in times[1:])


@given(TIMES)
def test_progress_pays_the_difference_of_its_ends(times):
    first, last = min(times[0], LONGEST), min(times[-1], LONGEST)
    assert total(Progress(LONGEST), times) == pytest.approx(PER_SECOND * (first - last), abs=1e-6)


@given(TIMES)
def test_the_nearest_yet_pays_its_best_and_takes_nothing_back(times):
    first = min(times[0], LONGEST)
    assert total(BestProgress(LONGEST), times) == pytest.approx(PER_SECOND * (first - min(first, *times)), abs=1e-6)
    pay = BestProgress(LONGEST)
    pay.begin(times[0])
    assert all(pay.step(seconds, False) >= 0.0 for seconds in times[1:])


@given(TIMES, st.floats(0.9, 1.0))
def test_shaping_is_worth_minus_its_potential_at_the_start(times, gamma):
    pay = Shaping(LONGEST, gamma)
    pay.begin(times[0])
    paid = [pay.step(seconds, index == len(times) - 2) for index, seconds in enumerate(times[1:])]
    worth = sum(gamma**index * each for index, each in enumerate(paid))
    assert worth == pytest.approx(-PER_SECOND * (LONGEST - min(times[0], LONGEST)), abs=1e-6)


@pytest.mark.parametrize("name", [*LADDER, *PRACTICE])
def test_no_episode_begins_near_the_goal(name):
    task = load_ladder_task(name)
    world = SimulatedWorld(task, options=SimulationOptions(engine="planar", rate=60 if task.plane == "xy" else 120))
    names = list(world.system.state_names)
    first, second = names.index("x"), names.index(task.plane[1])
    for seed in range(5):
        world.reset(seed)
        state = world.state(0)
        assert math.dist((state[first], state[second]), task.goal.region.position) > 1.5
    world.close()


@pytest.fixture(scope="module")
def value(tmp_path_factory):
    """Return the file of a coarse time to reach of the open field."""
    task = load_ladder_task("open_field")
    counts = dict.fromkeys(task.grid, 15)
    path = tmp_path_factory.mktemp("values") / f"{task_digest(task)[:12]}.safetensors"
    solve(problem_from_task(task, counts=counts, inflation=task.robot.radius)).grid.save(path)
    return path


@pytest.mark.parametrize(
    ("way", "learner"),
    [
        ("best_progress", "sac"),
        ("ttr", "ppo"),
        *((way, "ppo") for way in WAYS if WAYS[way].uses_states and WAYS[way].gae_lambda == 0.95),
    ],
)
def test_each_way_learns(way, learner, value, monkeypatch):
    monkeypatch.setattr(baseline, "SAMPLES", 64)
    monkeypatch.setattr(baseline, "_CLONING_STEPS", 20)
    monkeypatch.setattr(baseline, "_STATES", 64)
    monkeypatch.setattr(baseline, "_STEPS", 20)
    run = LadderRun("open_field", way, learner, 0, value)
    model = run.model(10_240)
    before = [each.detach().clone() for each in model.policy.parameters()]
    model.n_steps = 8
    if learner == "ppo":
        model.rollout_buffer.buffer_size = 8
        model.n_epochs = 1
    model.learning_starts = 10
    try:
        model.learn(64, reset_num_timesteps=False)
        changed = [
            not np.array_equal(a.detach().numpy(), b.detach().numpy())
            for a, b in zip(before, model.policy.parameters(), strict=True)
        ]
        assert any(changed)
    finally:
        model.env.close()


def test_results_of_other_methods_stay_in_the_file(tmp_path):
    file = tmp_path / "ladder.json"
    row = {name: Result(f"wall: {name}, sac", "success", "1", [0.5]) for name in ("sparse", "distance")}
    curve = {"samples": [10240], "success": [[0.5]]}
    write(file, 5, [row["sparse"], row["distance"]], {row["sparse"].method: curve, row["distance"].method: curve})
    better = Result(row["sparse"].method, "success", "1", [0.9, 1.0])
    curves = {better.method: {"samples": [10240], "success": [[0.9], [1.0]]}}
    write(file, 2, [better], curves)
    assert read_curves(file) == {row["distance"].method: curve, **curves}
    experiment = read_experiment(file)
    assert [(each.method, list(each.values)) for each in experiment.rows] == [
        (row["distance"].method, [0.5]),
        (better.method, [0.9, 1.0]),
    ]
    file.write_text("{}")
    with pytest.raises(ResultsError, match="not a file that `train --results` wrote"):
        write(file, 2, [better], curves)
    assert file.read_text() == "{}"

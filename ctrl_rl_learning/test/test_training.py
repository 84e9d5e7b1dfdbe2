"""Learning with the real library in the real simulator: it resumes exactly, and its policies need no torch."""

import csv
import subprocess
import sys
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.sb3.algorithm_names import ALGORITHMS
from ctrl_rl_learning.sb3.algorithms import extract_actor, make_algorithm
from ctrl_rl_learning.sb3.environment import evaluate, make_environment
from ctrl_rl_learning.sb3.records import load_visits
from ctrl_rl_learning.sb3.training import SimulatedRun
from ctrl_rl_learning.study.matrix import run_experiments
from ctrl_rl_learning.study.run import RunOptions, result_file
from ctrl_rl_learning.study.trainer import train
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from ctrl_rl_core import Actor, PolicyError, load_navigation_task

TASK = load_navigation_task("quad_ttr")
ROLL_OUT = 256
"""An eighth of the samples that learning takes between two updates."""
STEPS = {"ppo": {"n_steps": ROLL_OUT // 8}, "trpo": {"n_steps": ROLL_OUT // 16}, "ddpg": {}}
SHORT = {"iterations": 2, "samples": ROLL_OUT, "evaluations": 1, "final_evaluations": 2}


@dataclass(frozen=True)
class PlainRun(SimulatedRun):
    """Learns the quadrotor's task with the task's own reward."""

    algorithm: str
    seed: int
    task = TASK

    @property
    def name(self):
        return f"{self.algorithm}-{self.seed}"

    @property
    def description(self):
        return {"algorithm": self.algorithm, "seed": self.seed}

    def environment(self, rate=None):
        return make_environment(TASK, rate)

    def model(self, samples):
        return make_algorithm(self.algorithm, self.environment, self.seed, samples, **STEPS.get(self.algorithm, {}))

    def notes(self, model):
        return {"samples": model.num_timesteps}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_run_that_was_cut_off_ends_as_if_it_had_not_been(check_resuming, algorithm):
    folder = check_resuming(train, PlainRun(algorithm, 3), partial(RunOptions, **SHORT))
    counts = load_visits(folder / "visits.safetensors")
    assert counts["places"].shape[0] == 2
    assert counts["turns"].sum(axis=1).tolist() == [ROLL_OUT, ROLL_OUT]
    with (folder / "curve.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["samples"]) for row in rows] == [ROLL_OUT, 2 * ROLL_OUT]
    events = EventAccumulator(str(folder)).Reload()
    for name in ("success", "return", "loss", *(["entropy"] if algorithm in ("ppo", "sac") else [])):
        shown = [event.value for event in events.Scalars(name)]
        assert shown == pytest.approx([float(row[name]) for row in rows if row[name]])


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_deployed_policy_acts_like_the_learnt_one(tmp_path, algorithm):
    run = PlainRun(algorithm, 0)
    model = run.model(ROLL_OUT)
    file = tmp_path / "policy.safetensors"
    extract_actor(model, TASK, {"task": TASK.name}).save(file)
    actor = Actor.load(file)
    environment = run.environment()
    observations = np.random.default_rng(1).normal(0.0, 2.0, (500, len(actor.middle))).astype(np.float32)
    expected, _ = model.predict(observations, deterministic=True)
    assert np.array([actor.scaled_action(each) for each in observations]) == pytest.approx(expected, abs=1e-6)
    environment.reset(seed=1)
    command = actor.command(environment.unwrapped._observation())
    low, high = np.array(list(TASK.robot.commands.values())).T
    assert (command >= low - 1e-5).all()
    assert (command <= high + 1e-5).all()
    environment.close()
    model.env.close()


def test_evaluations_are_the_same_for_all():
    run = PlainRun("ppo", 0)
    model = run.model(ROLL_OUT)
    actor = extract_actor(model, TASK, {})
    environment = run.environment()
    first, second = (evaluate(actor, environment, 2, 7) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert (one.outcome, one.total) == (other.outcome, other.total)
        assert np.array_equal(one.states, other.states)
    environment.close()
    model.env.close()


def test_many_runs_on_several_cores_and_never_twice(tmp_path):
    runs = [PlainRun("ppo", seed) for seed in range(2)]
    options = RunOptions(tmp_path, 1, ROLL_OUT, 1, 1)
    results = run_experiments(runs, options, workers=2)
    assert [result["run"]["seed"] for result in results] == [0, 1]
    before = [result_file(tmp_path, run).stat().st_mtime_ns for run in runs]
    assert run_experiments(runs, options) == results
    assert before == [result_file(tmp_path, run).stat().st_mtime_ns for run in runs]


def test_a_finished_run_is_not_made_longer_and_says_what_to_do_instead(tmp_path):
    runs = [PlainRun("ppo", seed) for seed in (1, 0)]
    train(runs[1], RunOptions(tmp_path, 1, ROLL_OUT, 1, 1))
    what_to_do = r"result\.json: finished with 1 iterations .* ask for 1 again, or .* delete .*ppo-0 to train 2 from"
    with pytest.raises(LearningError, match=what_to_do):
        run_experiments(runs, RunOptions(tmp_path, 2, ROLL_OUT, 1, 1))
    assert not (tmp_path / "ppo-1").exists(), "it is said before anything is learnt"


def test_a_run_that_was_cut_off_may_go_on_to_more_iterations_but_not_to_fewer(tmp_path, cut_off):
    run = PlainRun("ppo", 0)
    cut_off(train, run, RunOptions(tmp_path, 2, ROLL_OUT, 0, 0))
    with pytest.raises(LearningError, match=r"checkpoint\.safetensors: already has 1 iterations: ask for no fewer"):
        train(run, RunOptions(tmp_path, 0, ROLL_OUT, 0, 0))
    told = []
    result = train(run, RunOptions(tmp_path, 3, ROLL_OUT, 0, 0), lambda _, done, __: told.append(done))
    assert len(result["curve"]) == 3
    assert told == [1, 2, 3], "where it goes on, and each iteration"


def test_a_broken_checkpoint_is_named(tmp_path):
    run = PlainRun("ppo", 0)
    checkpoint = tmp_path / run.name / "checkpoint.safetensors"
    checkpoint.parent.mkdir()
    checkpoint.write_bytes(b"half a file")
    with pytest.raises(LearningError, match=r"checkpoint\.safetensors: .*: cannot resume from it: delete it"):
        train(run, RunOptions(tmp_path, **SHORT))


def test_an_unknown_algorithm_is_named():
    with pytest.raises(LearningError, match="no algorithm 'a2c': there are ppo, trpo, ddpg, sac"):
        PlainRun("a2c", 0).model(ROLL_OUT)


def test_a_file_that_is_no_policy_is_named(tmp_path):
    file = tmp_path / "policy.safetensors"
    with pytest.raises(PolicyError, match="policy"):
        Actor.load(file)
    file.write_bytes(b"{}")
    with pytest.raises(PolicyError, match="learn it again"):
        Actor.load(file)


def test_the_deployed_policy_needs_no_torch():
    program = "import sys, ctrl_rl_core.policies.actor; sys.exit('torch' in sys.modules or 'gymnasium' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0

"""Closed loop of a team: learning from bags of an inefficient script."""

import numpy as np
import pytest
import torch
from ctrl_rl_core.io import read_json
from option_coordinator.data.bag_trajectory import recordings
from option_coordinator.data.team_bag import TeamBag
from option_coordinator.environments.tasks import make_environment
from option_coordinator.policies.policy_file import OptionPolicy
from option_coordinator.training.cli.learning import evaluate_offline as judge
from option_coordinator.training.cli.learning import loop
from option_coordinator.training.experiments.bag_runs import BagRun
from option_coordinator.training.experiments.closed_loop import CarelessScript, play
from option_coordinator.training.experiments.offline_evaluation import evaluate_offline
from option_coordinator.training.heads.heads import as_numpy
from option_coordinator.training.learners.learner import Imitation, decision_batch
from option_coordinator.training.learners.mappo import WeightedImitation

from ctrl_rl_core import CtrlRlError
from option_coordinator import OptionTrajectory

TASK = "tool_delivery"


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("careless") / "bag"
    environment = make_environment(TASK)
    with TeamBag(folder, environment.discount) as writer:
        episodes = list(play(environment, CarelessScript(environment, 0.5, 0), range(12), writer))
    assert len(episodes) == 12
    return folder


def test_what_is_played_stands_in_the_bag(bag):
    environment = make_environment(TASK)
    again = list(play(environment, CarelessScript(environment, 0.5, 0), range(12)))
    parts = [recording.trajectory for recording in recordings(bag)]
    assert [len(part) for part in parts] == [episode.decisions for episode in again]
    assert [part.reward.sum() for part in parts] == pytest.approx([episode.option_reward for episode in again])
    assert [bool(part.terminated[-1]) for part in parts] == [episode.terminated for episode in again]


def test_weighted_imitation_likes_best_what_paid(bag):
    trajectory = OptionTrajectory.joined([recording.trajectory for recording in recordings(bag)])
    agents, liked = make_environment(TASK).agents, []
    for make in (Imitation, WeightedImitation):
        torch.manual_seed(0)
        learner, generator = make(agents, "table"), np.random.default_rng(0)
        if isinstance(learner, WeightedImitation):
            for _ in range(5):
                learner.learn_value(trajectory, generator)
            gain = learner._batch(trajectory).gain.numpy()
        for _ in range(10):
            learner.learn(trajectory, generator)
        with torch.no_grad():
            liked.append(learner.network(decision_batch(trajectory)).log_prob.numpy())
    good, bad = gain > np.quantile(gain, 0.8), gain < np.quantile(gain, 0.2)
    plain, weighted = ((each[good].mean() - each[bad].mean()) for each in liked)
    assert weighted > plain + 0.3


def test_the_loop_goes_round_and_goes_on_where_it_was(tmp_path, capsys):
    arguments = ["--seeds", "1", "--rounds", "1", "--episodes", "10", "--tests", "2"]
    arguments += ["--folder", str(tmp_path / "runs")]
    assert loop([*arguments, "--results", str(tmp_path / "results.json")]) == 0
    said = capsys.readouterr().out
    assert "tool_delivery-s0: round 1: return" in said
    assert "called better before" in said
    assert "tool_delivery: weighted imitation, round 1" in said
    first = read_json(tmp_path / "runs" / "tool_delivery-s0" / "round_1" / "result.json")
    (tmp_path / "runs" / "tool_delivery-s0" / "round_1" / "result.json").unlink()
    assert loop(arguments) == 0
    again = read_json(tmp_path / "runs" / "tool_delivery-s0" / "round_1" / "result.json")
    assert again["returns"] == first["returns"]
    assert loop(["--careless", "2"]) == 1
    assert "--careless must be a probability" in capsys.readouterr().err
    assert loop(["--episodes", "9", "--folder", str(tmp_path / "few")]) == 1
    assert "--episodes must be at least 10" in capsys.readouterr().err
    assert not (tmp_path / "few").exists()


def test_bags_tell_what_a_policy_would_earn(bag, tmp_path, capsys):
    found, agents = recordings(bag), make_environment(TASK).agents
    trajectory = OptionTrajectory.joined([recording.trajectory for recording in found])
    predicted = []
    for rounds in (0, 8):  # draws any legal option; imitates what paid
        torch.manual_seed(0)
        learner, generator = WeightedImitation(agents, "table"), np.random.default_rng(0)
        for _ in range(rounds):
            learner.learn_value(trajectory, generator)
            learner.learn(trajectory, generator)
        policy = OptionPolicy(agents, "table", False, as_numpy(learner.network))
        report = evaluate_offline(found, policy, updates=300, fits=1)
        assert report.episodes == 12
        assert report.driver.low <= report.driver.mean <= report.driver.high
        assert report.gain.mean == pytest.approx(report.policy.mean - report.driver.mean)
        predicted.append(report.policy.mean)
        policy.save(tmp_path / f"after_{rounds}.safetensors")
    assert predicted[1] > predicted[0]
    judged = ["--policy", str(tmp_path / "after_0.safetensors"), "--updates", "50", "--fits", "1"]
    assert judge([str(bag), *judged, "--results", str(tmp_path / "told.json")]) == 1
    said = capsys.readouterr()
    assert "12 episodes" in said.out
    assert "not called better: the gain is" in said.err
    assert judge([str(bag), "--policy", "delivery_team"]) == 1
    said = capsys.readouterr().err
    assert "a bag: was recorded by another team, of " in said
    assert said.count("\n") == 1
    with pytest.raises(CtrlRlError, match="3 episodes are too few for an evaluation: record 7 more"):
        evaluate_offline(found[:3], policy)


def test_mappo_is_refused_without_own_decisions(bag):
    with pytest.raises(CtrlRlError, match="try --way weighted"):
        _ = BagRun((bag,), None, TASK, asked="mappo").way

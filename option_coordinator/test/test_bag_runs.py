"""End-to-end learning from bags: record a team, learn from its bag and compare the policies before and after."""

import json

import numpy as np
import pytest
import torch
from ctrl_rl_learning.study import RunOptions
from ctrl_rl_learning.study import train as train_run
from option_coordinator.environments.roll_out import RollOut
from option_coordinator.training.cli.learning import train
from option_coordinator.training.experiments.bag_runs import BagRun
from option_coordinator.training.experiments.runs import OptionRun
from option_coordinator.training.heads.heads import as_numpy
from option_coordinator.training.learners.learner import Imitation, decision_batch
from option_coordinator.training.learners.mappo import Mappo
from team_bag import TeamBag, play_into

from ctrl_rl_core import CtrlRlError
from option_coordinator import OptionPolicy, OptionTrajectory, make_environment, recordings, scripted_policy

TASK = "tool_delivery"


class CutOffError(Exception):
    """Simulated kill between two iterations."""


def cut_off(*_):
    raise CutOffError


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Untrained policy and a bag of its decisions."""
    folder = tmp_path_factory.mktemp("recorded")
    run = OptionRun(TASK, "async", 0)
    run.policy(run.learner(), {}).save(folder / "policy.safetensors")
    policy = OptionPolicy.load(folder / "policy.safetensors")
    with TeamBag(folder / "bag") as bag:
        play_into(bag, run.environment(), policy.joint, policy.digest, 20)
    return folder / "bag", folder / "policy.safetensors"


def test_a_policy_learns_from_its_own_bag(tmp_path, recorded, capsys):
    bag, start = recorded
    arguments = ["--bags", str(bag), "--from", str(start), "--task", TASK, "--folder", str(tmp_path)]
    assert train([*arguments, "--evaluations", "4"]) == 0
    words = capsys.readouterr().out
    decisions = sum(len(recording.trajectory) for recording in recordings(bag))
    assert f"{decisions} decisions, this policy's own, 0 others are left out" in words
    run = BagRun((bag,), start, TASK)
    result = json.loads((tmp_path / run.name / "result.json").read_text(encoding="utf-8"))
    assert result["run"]["way"] == "mappo"
    assert result["curve"][0]["update"]["ratio"] < 1e-4
    assert result["after"]["draws"]["return"] > result["before"]["draws"]["return"] + 30.0
    learnt = OptionPolicy.load(tmp_path / run.name / "policy.safetensors")
    assert learnt.manifest["from"] == OptionPolicy.load(start).digest != learnt.digest
    assert learnt.manifest["task"] == TASK
    assert train([*arguments, "--evaluations", "4"]) == 0  # read, not learnt again


def test_what_was_cut_off_ends_as_if_it_had_not_been(tmp_path, recorded):
    _, start = recorded
    policy = OptionPolicy.load(start)
    with TeamBag(tmp_path / "bag") as bag:
        play_into(bag, make_environment(TASK), policy.joint, policy.digest, 2)
    run, options = BagRun((tmp_path / "bag",), start), {"iterations": 2, "final_evaluations": 1}
    with pytest.raises(CutOffError):
        train_run(run, RunOptions(tmp_path / "cut", **options), cut_off)
    results = [train_run(run, RunOptions(tmp_path / name, **options)) for name in ("cut", "whole")]
    cut, whole = ([point["update"] for point in result["curve"]] for result in results)
    assert cut == whole
    one, other = (OptionPolicy.load(tmp_path / name / run.name / "policy.safetensors") for name in ("cut", "whole"))
    assert one.digest == other.digest


def record_script(folder, episodes=2):
    """Record the hand-written optimum."""
    environment = make_environment(TASK)
    chooser = scripted_policy(environment)
    with TeamBag(folder) as bag:
        for epoch in range(episodes):
            decision, number = environment.reset(0), 0
            while not decision.over:
                choices = chooser(decision)
                rows = zip(decision.agents, decision.running, strict=True)
                options = [choices.get(agent.name, running) for agent, running in rows]
                bag.put(decision, options, 0.0, "", number, epoch)
                decision, number = environment.step(choices), number + 1
            bag.put(decision, decision.running, 0.0, "", number, epoch)


def test_a_script_is_imitated_by_a_new_policy(tmp_path):
    record_script(tmp_path / "bag")
    run = BagRun((tmp_path / "bag",), task_name=TASK, head="autoregressive")
    assert run.way == "imitation"
    result = train_run(run, RunOptions(tmp_path / "runs", iterations=20, final_evaluations=1))
    assert result["curve"][-1]["update"]["log_prob"] > -0.3
    assert result["after"]["draws"]["return"] > result["before"]["draws"]["return"]


@pytest.mark.parametrize(("partial", "presence"), [(False, True), (True, False)])
def test_imitation_raises_the_probability_of_what_was_chosen(partial, presence):
    environment = make_environment(TASK, drop=float(presence))
    torch.manual_seed(0)
    learner, generator = Imitation(environment.agents, "table", partial, presence=presence), np.random.default_rng(0)
    trajectory = RollOut(environment, generator).collect(learner.behaviour(0.0), 100)
    found = [learner.learn(trajectory, generator)["log_prob"] for _ in range(3)]
    assert found[0] < found[1] < found[2]
    score = learner.network(decision_batch(trajectory, presence))
    assert score.log_prob.mean().item() > trajectory.log_prob.mean()


def test_decisions_of_others_are_left_out_where_there_are_own(tmp_path, recorded):
    bag, start = recorded
    record_script(tmp_path / "script", 1)
    run = BagRun((bag, tmp_path / "script"), start)
    own = OptionTrajectory.joined([recording.trajectory for recording in recordings(bag)])
    assert run.way == "mappo"
    (script,) = recordings(tmp_path / "script")
    assert (len(run.trajectory), run.left_out) == (len(own), len(script.trajectory))
    assert run.name != BagRun((bag,), start).name
    assert BagRun((tmp_path / "script",), start).way == "imitation"


def test_what_does_not_fit_is_refused_in_one_line(tmp_path, recorded, capsys):
    bag, start = recorded
    other = make_environment("water_filling")
    with TeamBag(tmp_path / "water") as water:
        play_into(water, other, Mappo(other.agents, "table").behaviour(0.0), "", 1)
    (tmp_path / "damaged").mkdir()
    for arguments, words in (
        (["--bags", tmp_path / "water", "--from", start], "was recorded by another team, of "),
        (["--bags", bag], "give a policy with --from, or a --task"),
        (["--bags", bag, "--from", start, "--task", "water_filling"], "is for other robots"),
        (["--bags", tmp_path / "damaged", "--from", start], "is no bag"),
        (["--bags", bag, "--from", bag], "is a folder"),
        (["--from", start, "--task", TASK], "--from goes with --bags"),
        ([], "give a --task"),
    ):
        assert train([*map(str, arguments), "--folder", str(tmp_path / "runs")]) == 1
        said = capsys.readouterr().err
        assert said.startswith("train: ")
        assert words in said
        assert said.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_a_policy_that_does_not_draw_or_did_not_say_so_is_refused(tmp_path, recorded):
    _, start = recorded
    policy = OptionPolicy.load(start)
    environment = make_environment(TASK)
    greedy = OptionPolicy(environment.agents, "table", False, policy.tensors, greedy=True)
    greedy.save(tmp_path / "greedy.safetensors")
    with TeamBag(tmp_path / "bag") as own:
        play_into(own, environment, greedy.joint, greedy.digest, 1)
    with pytest.raises(CtrlRlError, match="takes its most likely options"):
        BagRun((tmp_path / "bag",), tmp_path / "greedy.safetensors").learner()
    torch.manual_seed(1)
    stranger = Mappo(environment.agents, "table")
    with torch.no_grad():
        stranger.network.head.weight.add_(torch.randn_like(stranger.network.head.weight))
    OptionPolicy(environment.agents, "table", False, as_numpy(stranger.network)).save(tmp_path / "s.safetensors")
    with TeamBag(tmp_path / "lie") as lie:
        play_into(lie, environment, policy.joint, OptionPolicy.load(tmp_path / "s.safetensors").digest, 1)
    with pytest.raises(CtrlRlError, match="do not match it"):
        train_run(BagRun((tmp_path / "lie",), tmp_path / "s.safetensors"), RunOptions(tmp_path / "runs", 1))

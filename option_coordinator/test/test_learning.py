"""Learning: components against closed forms, resuming, and improvement of the policy."""

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
import torch
import yaml
from ctrl_rl_learning.study import RunOptions, result_file, run_experiments, train
from ctrl_rl_learning.torch import ReplayBuffer
from hypothesis import given, settings
from hypothesis import strategies as st
from option_coordinator.data.trajectory import advantages
from option_coordinator.environments.roll_out import JointDecisionPolicy, RollOut
from option_coordinator.options.options import Scene
from option_coordinator.training.cli.learning import train as train_command
from option_coordinator.training.experiments.evaluation import evaluate, summary
from option_coordinator.training.experiments.methods import METHODS, usual_methods
from option_coordinator.training.experiments.runs import OptionRun, option_runs
from option_coordinator.training.heads.head_parts import ValueNetwork
from option_coordinator.training.heads.heads import make_head
from option_coordinator.training.learners.learner import decision_batch
from option_coordinator.training.learners.mac_dqn import EpsilonGreedy, MacDqn
from option_coordinator.training.learners.mappo import Mappo, MappoSettings

from ctrl_rl_core import CtrlRlError
from option_coordinator import (
    NONE,
    Agent,
    OptionEnvironment,
    OptionEpisode,
    OptionError,
    OptionPolicy,
    OptionTrajectory,
    SimulationStep,
    load_option_task,
    make_environment,
    play_episodes,
    scripted_policy,
    team_file,
)

SHORT = {"iterations": 2, "samples": 200, "final_evaluations": 1}


def gathered(samples=400, seed=0, head="table", partial=False):
    environment = make_environment("tool_delivery")
    torch.manual_seed(seed)
    learner = Mappo(environment.agents, head, partial)
    roll_out = RollOut(environment, np.random.default_rng(seed))
    return learner, roll_out.collect(learner.behaviour(0.0), samples), roll_out


def naive_advantages(trajectory, values, after, gae_lambda):
    """sum_l prod(gamma^tau lambda) delta: an independent implementation."""
    out = []
    for begin in range(len(trajectory)):
        total, weight = 0.0, 1.0
        for step in range(begin, len(trajectory)):
            onward = 0.0 if trajectory.terminated[step] else trajectory.discount[step] * after[step]
            total += weight * (trajectory.reward[step] + onward - values[step])
            if trajectory.last[step]:
                break
            weight *= trajectory.discount[step] * gae_lambda
        out.append(total)
    return np.array(out)


def test_advantages_discount_by_what_an_option_took():
    _, trajectory, _ = gathered()
    generator = np.random.default_rng(0)
    values, after = generator.normal(size=(2, len(trajectory)))
    expected = naive_advantages(trajectory, values, after, 0.95)
    assert advantages(trajectory, values, after, 0.95) == pytest.approx(expected)


def test_with_lambda_one_advantages_are_discounted_returns_of_low_level_steps():
    """G^1 of the first option step is sum_k gamma^k r_k over the low-level steps, for any option durations."""
    environment = make_environment("tool_delivery")
    choose, steps, rewards = scripted_policy(environment), [], []
    decision = environment.reset(0)
    while not decision.over:
        before = decision
        choices = choose(before)
        decision = environment.step(choices)
        rows = zip(before.agents, before.running, strict=True)
        options = np.array([choices.get(agent.name, running) for agent, running in rows])
        steps.append((before, options, 0.0, decision))
        rewards += decision.rewards
    trajectory = OptionTrajectory.of(steps)
    values = np.random.default_rng(0).normal(size=len(trajectory))
    gains = advantages(trajectory, values, np.append(values[1:], 0.0), 1.0)
    assert gains[0] + values[0] == pytest.approx(sum(reward * 0.99**k for k, reward in enumerate(rewards)))
    assert trajectory.duration.sum() == len(rewards)


@pytest.mark.parametrize(
    ("head", "partial"), [("table", False), ("mixture", False), ("autoregressive", False), ("table", True)]
)
def test_the_ratio_is_one_on_the_first_epoch(head, partial):
    learner, trajectory, _ = gathered(200, 0, head, partial)
    assert (~trajectory.choosing).any()  # some ran on: the unconditional ratio would not be 1
    generator = np.random.default_rng(0)
    for _ in range(2):
        assert learner.learn(trajectory, generator)["ratio"] < 1e-5
        trajectory = RollOut(make_environment("tool_delivery"), generator).collect(learner.behaviour(0.0), 200)


def test_trajectories_of_batches_follow_each_other():
    learner, trajectory, roll_out = gathered(400)
    assert trajectory.last[-1]
    again = roll_out.collect(learner.behaviour(0.0), 100)
    goes_on = np.array_equal(again.observation[0], trajectory.next_observation[-1])
    assert goes_on or again.choosing[0].all()  # else a fresh episode
    joined = OptionTrajectory.joined([trajectory, again])
    assert len(joined) == len(trajectory) + len(again)
    end = int(np.argmax(trajectory.last))  # of the first episode
    assert np.all(trajectory.choosing[0])
    assert np.all(trajectory.running[0] == NONE)
    assert np.array_equal(trajectory.next_running[:end], trajectory.running[1 : end + 1])
    with pytest.raises(CtrlRlError, match="lengths"):
        replace(trajectory, reward=trajectory.reward[:-1])
    with pytest.raises(CtrlRlError, match="no trajectory"):
        OptionTrajectory.joined([])


def test_values_are_learnt_on_a_scale_of_their_own():
    torch.manual_seed(0)
    network = ValueNetwork(3, (2, 2))
    observation, running = torch.randn(8, 3), torch.tensor([[NONE, 1]] * 8)
    assert torch.equal(network.values(observation, running), network(observation, running))
    targets = 100.0 + 20.0 * torch.randn(4000)
    scaled = network.scale.count(targets)
    assert scaled.mean().item() == pytest.approx(0.0, abs=1e-3)
    assert scaled.std().item() == pytest.approx(1.0, abs=1e-2)
    assert network.values(observation, running).mean().item() == pytest.approx(100.0, abs=40.0)
    other = network(observation, torch.tensor([[NONE, 0]] * 8))
    assert not torch.allclose(network(observation, running), other)  # what runs on is part of the state


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_the_target_of_mac_dqn_agrees_with_what_runs(seed):
    """Against an exhaustive search over joint options."""
    environment = make_environment("tool_delivery")
    torch.manual_seed(seed)
    learner = MacDqn(environment.agents)
    with torch.no_grad():
        for network in (learner.network, learner.target):
            network.head.weight.normal_()
    roll_out = RollOut(environment, np.random.default_rng(seed))
    batch = roll_out.collect(learner.behaviour(0.0), 60)
    found = learner._next_values(batch)
    cells = learner.network.cells.numpy()
    following = torch.from_numpy(batch.next_observation)
    online, target = learner.network.logits(following), learner.target.logits(following)
    for step in range(len(batch)):
        fixed = batch.next_running[step] != NONE
        fits = [c for c, cell in enumerate(cells) if np.all(cell[fixed] == batch.next_running[step][fixed])]
        best = max(fits, key=lambda c: online[step, c].item())
        assert found[step].item() == pytest.approx(target[step, best].item())


@pytest.mark.parametrize("discount", [0.99, 1.0])
def test_mac_dqn_learns_values_as_large_as_returns_in_a_few_hundred_steps(discount):
    """Targets are near 190; their scale is normalised, so the network's outputs need not grow to it."""
    environment = make_environment("tool_delivery", discount=discount)
    torch.manual_seed(0)
    learner, generator = MacDqn(environment.agents), np.random.default_rng(0)
    trajectory = RollOut(environment, generator).collect(learner.behaviour(0.0), 300)
    wanted = np.where(trajectory.choosing[:, 2], 190.0, 150.0)
    ended = replace(trajectory, reward=wanted, terminated=np.ones(len(trajectory), dtype=bool))
    for _ in range(180):
        learner.learn(ended, generator)
    choice = decision_batch(ended)
    cells = learner.network.cell(choice.options)[:, None]
    values = learner.scale.undo(learner.network.logits(choice.observation).gather(1, cells)[:, 0])
    assert values.mean().item() == pytest.approx(wanted.mean(), abs=5.0)
    assert learner._samples == 180 * trajectory.duration.sum()


def test_the_replay_keeps_the_latest():
    _, trajectory, _ = gathered(200)
    count = len(trajectory)
    replay = ReplayBuffer(count + 5)
    for number in range(3):
        replay.add(vars(replace(trajectory, reward=np.full(count, float(number)))))
    assert len(replay) == count + 5
    drawn = replay.draw(2000, np.random.default_rng(0))
    assert set(drawn["reward"]) == {1.0, 2.0}
    assert np.mean(drawn["reward"] == 2.0) == pytest.approx(count / (count + 5), abs=0.03)
    other = ReplayBuffer(count + 5)
    other.restore(replay.arrays())
    again = other.draw(2000, np.random.default_rng(0))
    assert all(np.array_equal(again[name], drawn[name]) for name in drawn)


def test_large_batches_are_learnt_in_parts():
    environment = make_environment("tool_delivery")
    torch.manual_seed(0)
    learner = Mappo(environment.agents, "table", settings=MappoSettings(minibatch=64, epochs=2))
    generator = np.random.default_rng(0)
    trajectory = RollOut(environment, generator).collect(learner.behaviour(0.0), 400)
    assert learner.learn(trajectory, generator)["ratio"] < 1e-5
    steps = next(iter(learner.optimizers["optimizer"].state_dict()["state"].values()))["step"]
    assert steps == 2 * round(len(trajectory) / 64) > 2


def test_figures_of_option_steps_are_pooled():
    """One episode with 1 option step and one with 3; the thesis's figure keeps the last low-level reward of each."""
    one = OptionEpisode(returned=4.0, steps=4, decisions=1, option_reward=4.0, last_reward=2.0)
    other = OptionEpisode(returned=0.0, steps=4, decisions=3, option_reward=0.0, last_reward=6.0)
    found = summary([one, other])
    assert (found["return"], found["option_reward"], found["last_reward"]) == (2.0, 1.0, 2.0)
    environment = make_environment("tool_delivery")
    script = summary(list(play_episodes(environment, scripted_policy(environment), range(1))))
    assert script["option_reward"] == pytest.approx(13.55, abs=0.01)


@pytest.mark.parametrize("method", ["async", "mac_dqn"])
def test_what_is_judged_is_what_is_saved(tmp_path, method):
    run = OptionRun("tool_delivery", method, 1)
    result = train(run, RunOptions(tmp_path, **SHORT))
    policy = OptionPolicy.load(tmp_path / run.name / "policy.safetensors")
    assert result["used"] == policy.manifest["used"] == ("mode" if policy.greedy else "draws")
    mode = JointDecisionPolicy(policy.joint)
    assert result["final"]["mode"] == summary(list(play_episodes(run.environment(), mode, range(2_000_000, 2_000_001))))
    if not policy.greedy:
        draws = JointDecisionPolicy(policy.joint, np.random.default_rng((2_000_000, 1, 1)))
        episodes = play_episodes(run.environment(), draws, range(2_000_000, 2_000_001))
        assert result["final"]["draws"] == summary(list(episodes))
    decision, generator = run.environment().reset(0), np.random.default_rng(0)
    choices = [policy.choose(decision, generator) for _ in range(30)]
    assert (len({tuple(choice.values()) for choice in choices}) == 1) == policy.greedy


def test_epsilon_greedy_is_what_it_says():
    environment = make_environment("tool_delivery")
    learner = MacDqn(environment.agents)
    explorer = learner.behaviour(0.25)
    assert isinstance(explorer, EpsilonGreedy)
    assert explorer.epsilon == pytest.approx(0.55)
    assert learner.behaviour(1.0).epsilon == pytest.approx(0.1)
    decision = environment.reset(0)
    conditional = explorer.given(decision.observation, decision.choosing, decision.running, decision.legal)
    choices = conditional.choices()
    probabilities = np.exp(conditional.log_prob(choices))
    assert probabilities.sum() == pytest.approx(1.0)
    assert sorted(set(probabilities.round(6))) == pytest.approx([0.55 / 54, 0.55 / 54 + 0.45], abs=1e-6)


@pytest.mark.parametrize("method", ["async_mixture", "partial", "mac_dqn", "end2end"])
def test_a_run_that_was_cut_off_ends_as_if_it_had_not_been(check_resuming, method):
    folder = check_resuming(train, OptionRun("tool_delivery", method, 3), partial(RunOptions, **SHORT))
    assert not (folder / "checkpoint.safetensors").exists()


def test_a_folder_of_another_run_is_refused(tmp_path, cut_off):
    run = OptionRun("tool_delivery", "async", 0)
    cut_off(train, run, RunOptions(tmp_path, **SHORT))
    with pytest.raises(CtrlRlError, match="samples 200, now it is 100"):
        train(run, RunOptions(tmp_path, **(SHORT | {"samples": 100})))
    with pytest.raises(CtrlRlError, match="evaluations 1, now it is 2"):
        train(run, RunOptions(tmp_path, **(SHORT | {"final_evaluations": 2})))
    (tmp_path / run.name / "checkpoint.safetensors").write_bytes(b"nonsense")
    with pytest.raises(CtrlRlError, match="cannot resume from it"):
        train(run, RunOptions(tmp_path, **SHORT))


@pytest.mark.usefixtures("runs_here")
def test_many_runs_one_after_the_other(tmp_path):
    runs = option_runs("tool_delivery", ["sync_cut", "async"], 1)
    assert [run.method_name for run in runs] == ["async", "sync_cut"]
    assert option_runs("tool_delivery", ["async", "sync_cut", "async"], 1) == runs
    options = RunOptions(tmp_path, **(SHORT | {"iterations": 1}))
    results = run_experiments(runs, options)
    assert [result["run"]["method"] for result in results] == ["async", "sync_cut"]
    assert run_experiments(runs, options) == results
    result_file(tmp_path, runs[0]).write_text("{", encoding="utf-8")
    with pytest.raises(CtrlRlError, match=r"async-s0/result\.json: .*: is not the result of a finished run"):
        run_experiments(runs, options)


def test_every_method_has_an_environment_and_a_learner():
    for task in ("tool_delivery", "water_filling"):
        for name in [name for name, method in METHODS.items() if task in method.kinds]:
            run = OptionRun(task, name, 0)
            policy = run.policy(run.learner(), {})
            sizes = [agent.observation_size for agent in run.environment().agents]
            assert policy.joint.observation_size == sum(sizes)
    assert (
        OptionRun("tool_delivery", "mac_dqn_long", 0).budget * load_option_task("tool_delivery").training_samples
        == 400_000
    )
    assert (
        OptionRun("water_filling", "mac_dqn_long", 0).budget * load_option_task("water_filling").training_samples
        == 600_000
    )
    with pytest.raises(CtrlRlError, match="no method 'x'"):
        OptionRun("tool_delivery", "x", 0).learner()


class Matching:
    """A step pays 1 if the options agree, and 1 if the leader's, held for 3 steps, matches its random target."""

    agents = (Agent("leader", ("a", "b"), 2), Agent("follower", ("a", "b"), 1))
    step_limit, time_step, room = 40, 1.0, ((0.0, 1.0), (0.0, 1.0))
    landmarks: dict[str, tuple[float, float]] = {}  # noqa: RUF012
    observes_while_running = False

    def reset(self, generator):
        self._generator = generator
        self._option, self._left = [None, None], 0
        self._wanted = int(generator.integers(2))

    def begin(self, agent, option):
        self._option[agent] = option
        if agent == 0:
            self._left = 3

    def interrupt(self, agent):
        self._option[agent] = None

    def step(self):
        leader, follower = self._option
        reward = float(leader == self._wanted) + float(leader == follower)
        self._left -= 1
        self._option[1] = None
        if self._left == 0:
            self._option[0] = None
            self._wanted = int(self._generator.integers(2))
        return SimulationStep(reward, (self._left == 0, True), False)

    def observe(self, agent):
        seen = [float(self._wanted == 0), float(self._wanted == 1)] if agent == 0 else [0.0]
        return np.array(seen, dtype=np.float32)

    def legal(self, agent):  # noqa: ARG002
        return np.ones(2, dtype=bool)

    def scene(self):
        return Scene({"leader": (0.0, 0.0), "follower": (0.0, 0.0)}, "")

    def figures(self):
        return {}


@pytest.mark.parametrize("head", ["table", "mixture", "autoregressive"])
def test_a_follower_learns_from_the_condition_alone(head):
    """The follower observes nothing and chooses during the leader's option; pi-hat's condition is its only input."""
    environment = OptionEnvironment(Matching(), 0.9)
    torch.manual_seed(0)
    learner = Mappo(environment.agents, head)
    generator = np.random.default_rng(0)
    roll_out = RollOut(environment, generator)
    for _ in range(24):
        learner.learn(roll_out.collect(learner.behaviour(0.0), 120), generator)
    found = evaluate(environment, learner.behaviour(1.0), learner.behaviour(1.0), 5, 0)
    assert found["mode"]["return"] > 0.95 * 80.0


def test_parts_of_a_trajectory_are_what_the_document_says():
    _, trajectory, _ = gathered(200)
    steps, agents, most = len(trajectory), 3, 6
    shapes = {"observation": (30,), "options": (agents,), "choosing": (agents,), "legal": (agents, most)}
    shapes |= {f"next_{name}": shapes[name] for name in ("observation", "legal")}
    shapes |= {"next_running": (agents,), "next_present": (agents,)}
    for field in fields(trajectory):
        assert getattr(trajectory, field.name).shape == (steps, *shapes.get(field.name, ()))


@pytest.mark.fault
def test_a_team_too_large_for_a_joint_table_learns_the_mixture_and_refuses_the_table(tmp_path, capsys):
    assert usual_methods((6, 6, 6)) == ("async", "sync_wait")
    assert usual_methods((6,) * 7) == ("async_mixture",)
    with pytest.raises(OptionError, match=r"a joint table of 7 robots has 2\.8e\+05 cells, more than 50000: use the"):
        make_head("table", [Agent(f"r{i}", tuple("abcdef"), 4) for i in range(7)])
    team = yaml.safe_load(team_file("delivery_team").read_text())
    homes = {f"robot_{i}": {"home": f"({-1.6 + 0.53 * i}, -1.2) m"} for i in range(7)}
    (tmp_path / "seven.yaml").write_text(yaml.safe_dump(team | {"name": "seven", "robots": homes}, sort_keys=False))
    assert train_command(["--task", str(tmp_path / "seven.yaml"), "--methods", "async", "--seeds", "1"]) == 1
    assert "--methods async_mixture" in capsys.readouterr().err

"""Learning: its pieces against closed forms, resuming, and that it learns at all."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_training.matrix import train_all
from ctrl_rl_training.run_folder import result_file
from hypothesis import given, settings
from hypothesis import strategies as st
from option_coordinator.decision import NONE
from option_coordinator.event_driven import OptionEnvironment
from option_coordinator.options import Agent, Scene, SimulationStep
from option_coordinator.policy_file import OptionPolicy
from option_coordinator.roll_out import RollOut, play_episodes
from option_coordinator.tasks import make_environment
from option_coordinator.training.mac_dqn import EpsilonGreedy, MacDqn
from option_coordinator.training.mappo import Mappo
from option_coordinator.training.methods import METHODS
from option_coordinator.training.runs import OptionRun, RunOptions, option_runs, summary, train_one
from option_coordinator.training.value import ValueNetwork
from option_coordinator.trajectory import Trajectory, advantages

SHORT = {"iterations": 2, "samples": 200, "evaluations": 1, "final_evaluations": 1}


class CutOffError(Exception):
    """Stands for a kill between two iterations."""


def cut_off(*_):
    raise CutOffError


def gathered(samples=400, seed=0, head="table", partial=False):
    environment = make_environment("tool_delivery")
    torch.manual_seed(seed)
    learner = Mappo(environment.agents, head, partial)
    roll_out = RollOut(environment, np.random.default_rng(seed))
    return learner, roll_out.collect(learner.behaviour(0.0), samples), roll_out


def naive_advantages(trajectory, values, after, trace):
    """sum_l prod(gamma^tau lambda) delta, written down once more."""
    out = []
    for begin in range(len(trajectory)):
        total, weight = 0.0, 1.0
        for step in range(begin, len(trajectory)):
            onward = 0.0 if trajectory.terminated[step] else trajectory.discount[step] * after[step]
            total += weight * (trajectory.reward[step] + onward - values[step])
            if trajectory.last[step]:
                break
            weight *= trajectory.discount[step] * trace
        out.append(total)
    return np.array(out)


def test_advantages_discount_by_what_an_option_took():
    _, trajectory, _ = gathered()
    generator = np.random.default_rng(0)
    values, after = generator.normal(size=(2, len(trajectory)))
    expected = naive_advantages(trajectory, values, after, 0.95)
    assert advantages(trajectory, values, after, 0.95) == pytest.approx(expected)


def test_with_lambda_one_and_true_values_there_is_no_advantage_in_a_fixed_course():
    """Returns of option steps are those of low-level steps: sum_k gamma^k r_k, whatever the options took."""
    environment = make_environment("tool_delivery")
    from option_coordinator.scripted import scripted_chooser

    choose, rewards, options = scripted_chooser(environment), [], []
    decision = environment.reset(0)
    while not decision.over:
        decision = environment.step(choose(decision))
        rewards += decision.rewards
        options.append((decision.reward, decision.discount))
    low_level = sum(reward * 0.99**k for k, reward in enumerate(rewards))
    total = 0.0
    for reward, discount in reversed(options):
        total = reward + discount * total
    assert total == pytest.approx(low_level)


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
    assert len(trajectory.episodes()) == trajectory.last.sum()
    joined = Trajectory.joined([trajectory, again])
    assert len(joined) == len(trajectory) + len(again)
    first, *_ = trajectory.episodes()
    assert np.all(first.choosing[0])
    assert np.all(first.running[0] == NONE)
    after = first.next_running[:-1]
    assert np.array_equal(after, first.running[1:])
    with pytest.raises(CtrlRlError, match="lengths"):
        replace(trajectory, reward=trajectory.reward[:-1])
    with pytest.raises(CtrlRlError, match="no trajectory"):
        Trajectory.joined([])


def test_values_are_learnt_on_a_scale_of_their_own():
    torch.manual_seed(0)
    network = ValueNetwork(3, (2, 2))
    observation, running = torch.randn(8, 3), torch.tensor([[NONE, 1]] * 8)
    assert torch.equal(network.values(observation, running), network(observation, running))
    targets = 100.0 + 20.0 * torch.randn(4000)
    scaled = network.rescale(targets)
    assert scaled.mean().item() == pytest.approx(0.0, abs=1e-3)
    assert scaled.std().item() == pytest.approx(1.0, abs=1e-2)
    assert network.values(observation, running).mean().item() == pytest.approx(100.0, abs=40.0)
    other = network(observation, torch.tensor([[NONE, 0]] * 8))
    assert not torch.allclose(network(observation, running), other)  # what runs on is part of the state


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_the_target_of_mac_dqn_agrees_with_what_runs(seed):
    """Against a search among joint options, one by one."""
    environment = make_environment("tool_delivery")
    torch.manual_seed(seed)
    learner = MacDqn(environment.agents, 0.99)
    with torch.no_grad():
        for network in learner.networks().values():
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


def test_epsilon_greedy_is_what_it_says():
    environment = make_environment("tool_delivery")
    learner = MacDqn(environment.agents, 0.99)
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
def test_a_run_that_was_cut_off_ends_as_if_it_had_not_been(tmp_path, method):
    run = OptionRun("tool_delivery", method, 3)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    train_one(run, RunOptions(whole, **SHORT))
    with pytest.raises(CutOffError):
        train_one(run, RunOptions(cut, **SHORT), report=cut_off)
    assert not result_file(cut, run).exists()
    train_one(run, RunOptions(cut, **SHORT))

    def learnt(folder):
        result = json.loads(result_file(folder, run).read_text(encoding="utf-8"))
        for point in result["curve"]:
            del point["seconds"]
        return result

    assert learnt(cut) == learnt(whole)
    one, other = (OptionPolicy.load(folder / run.name / "policy.safetensors") for folder in (whole, cut))
    assert one.digest == other.digest
    assert not (cut / run.name / "checkpoint.safetensors").exists()


def test_a_folder_of_another_run_is_refused(tmp_path):
    run = OptionRun("tool_delivery", "async", 0)
    with pytest.raises(CutOffError):
        train_one(run, RunOptions(tmp_path, **SHORT), report=cut_off)
    with pytest.raises(CtrlRlError, match="samples 200, now it is 100"):
        train_one(run, RunOptions(tmp_path, **(SHORT | {"samples": 100})))
    (tmp_path / run.name / "checkpoint.safetensors").write_bytes(b"nonsense")
    with pytest.raises(CtrlRlError, match="cannot go on from it"):
        train_one(run, RunOptions(tmp_path, **SHORT))


def test_many_runs_at_a_time(tmp_path):
    runs = option_runs("tool_delivery", ["sync_cut", "async"], 1)
    assert [run.method_name for run in runs] == ["async", "sync_cut"]
    options = RunOptions(tmp_path, **(SHORT | {"iterations": 1}))
    results = train_all(runs, options, workers=2, train=train_one)
    assert [result["run"]["method"] for result in results] == ["async", "sync_cut"]
    assert train_all(runs, options, train=train_one) == results


def test_every_method_has_an_environment_and_a_learner():
    for task in ("tool_delivery", "water_filling"):
        for name in METHODS:
            run = OptionRun(task, name, 0)
            policy = run.policy(run.learner(), {})
            sizes = [agent.observation_size for agent in run.environment().agents]
            assert policy.joint.observation_size == sum(sizes)
    with pytest.raises(CtrlRlError, match="no method 'x'"):
        OptionRun("tool_delivery", "x", 0).learner()


class Matching:
    """Two agents get 1 a step while their options agree; the first one's option is drawn, lasts and is seen by both."""

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
    """It sees nothing and chooses while the leader's option runs: only pi-hat's condition can tell it what to do."""
    environment = OptionEnvironment(Matching(), 0.9)
    torch.manual_seed(0)
    learner = Mappo(environment.agents, head)
    generator = np.random.default_rng(0)
    roll_out = RollOut(environment, generator)
    for _ in range(40):
        learner.learn(roll_out.collect(learner.behaviour(0.0), 120), generator)
    policy = OptionPolicy(environment.agents, head, False, {}, manifest={})
    policy.__dict__["joint"] = learner.behaviour(1.0)
    episodes = list(play_episodes(environment, policy.choose, range(5)))
    assert summary(episodes)["return"] > 0.95 * 80.0


def test_parts_of_a_trajectory_are_what_the_document_says():
    _, trajectory, _ = gathered(200)
    steps, agents, most = len(trajectory), 3, 6
    shapes = {"observation": (30,), "options": (agents,), "choosing": (agents,), "legal": (agents, most)}
    shapes |= {f"next_{name}": shapes[name] for name in ("observation", "legal")} | {"next_running": (agents,)}
    for field in fields(trajectory):
        assert getattr(trajectory, field.name).shape == (steps, *shapes.get(field.name, ()))

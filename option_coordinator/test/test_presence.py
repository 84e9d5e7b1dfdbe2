"""Robots that disappear and return: in the environment, the policy's observations and learning."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from option_coordinator.environments.option_env import draw_dropout
from option_coordinator.environments.roll_out import RollOut
from option_coordinator.options.options import Scene
from option_coordinator.policies.policy_file import HEADS, make_policy
from option_coordinator.training.experiments.runs import OptionRun
from option_coordinator.training.heads.heads import as_numpy
from option_coordinator.training.learners.learner import decision_batch
from option_coordinator.training.learners.mappo import Mappo

from ctrl_rl_core import CtrlRlError
from option_coordinator import (
    NONE,
    Agent,
    OptionEnvironment,
    OptionPolicy,
    RandomPolicy,
    SimulationStep,
    make_environment,
)

ALONE, TOGETHER = range(2)


class Lifting:
    """Two agents choose at each step; both get 1 for option `TOGETHER` if both are present, for `ALONE` otherwise."""

    agents = (Agent("left", ("alone", "together"), 1), Agent("right", ("alone", "together"), 1))
    step_limit, time_step, room = 20, 1.0, ((0.0, 1.0), (0.0, 1.0))
    landmarks: dict[str, tuple[float, float]] = {}  # noqa: RUF012
    observes_while_running = False

    def reset(self, generator):  # noqa: ARG002
        self._option = [None, None]

    def begin(self, agent, option):
        self._option[agent] = option

    def interrupt(self, agent):
        self._option[agent] = None

    def step(self):
        acting = tuple(option is not None for option in self._option)
        right = TOGETHER if all(acting) else ALONE
        reward = sum(option == right for option in self._option)
        self._option = [None, None]
        return SimulationStep(float(reward), acting, False)

    def observe(self, agent):  # noqa: ARG002
        return np.zeros(1, dtype=np.float32)

    def legal(self, agent):  # noqa: ARG002
        return np.ones(2, dtype=bool)

    def scene(self):
        return Scene({"left": (0.0, 0.0), "right": (0.0, 0.0)}, "")

    def figures(self):
        return {}


def play(environment, seed):
    chooser = RandomPolicy(seed)
    decisions = [environment.reset(seed)]
    while not decisions[-1].over:
        decisions.append(environment.step(chooser(decisions[-1])))
    return decisions


@pytest.mark.parametrize("synchronisation", ["async", "wait", "cut"])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_who_is_absent_neither_chooses_nor_runs_and_nobody_waits_for_it(synchronisation, seed):
    environment = make_environment("tool_delivery", synchronisation, drop=1.0)
    decisions = play(environment, seed)
    agent, begin, end = environment._dropout
    name = environment.agents[agent].name
    at = 0
    for decision in decisions:
        at += decision.duration
        gone = begin <= at < end
        assert decision.present.tolist() == [i != agent or not gone for i in range(3)]
        assert not np.any(decision.choosing & ~decision.present)
        assert np.all(decision.running[~decision.present] == NONE)
        assert decision.over or decision.choosing.any()
        if synchronisation == "wait" and not decision.over:
            assert np.array_equal(decision.choosing, decision.present)
    assert at == environment.steps
    if synchronisation == "async" and end < at:
        assert any(decision.choosing[agent] for decision in decisions[1:])
    assert all(s.end <= begin or s.begin >= end for s in environment.trace.spans if s.agent == name)


def test_without_a_chance_nothing_is_drawn():
    one, other = np.random.default_rng(0), np.random.default_rng(0)
    assert draw_dropout(0.0, 3, 150, one) is None
    assert one.random() == other.random()
    found = [draw_dropout(0.3, 3, 150, one) for _ in range(1000)]
    assert sum(outage is not None for outage in found) == pytest.approx(300, abs=50)
    assert {outage.agent for outage in found if outage} == {0, 1, 2}
    assert all(1 <= outage.begin < outage.end < 150 for outage in found if outage)


@pytest.mark.parametrize("head", HEADS)
def test_absent_and_choosing_look_different_to_a_policy_that_is_told(tmp_path, head):
    """Probabilities for one robot's options depend on whether the other is absent or chooses too; the same in torch."""
    environment = OptionEnvironment(Lifting(), drop=1.0)
    torch.manual_seed(0)
    learner = Mappo(environment.agents, head, presence=True)
    with torch.no_grad():
        for parameter in learner.network.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    policy = learner.behaviour(0.0)
    both, one = np.array([True, True]), np.array([True, False])
    nobody, seen = np.array([NONE, NONE]), np.zeros(2)
    joint = np.exp(policy.given(seen, both, nobody).log_prob(np.array([[0, 0], [0, 1]])))
    alone = np.exp(policy.given(seen, one, nobody).log_prob(np.array([[0, NONE]])))
    assert abs(joint.sum() - alone[0]) > 1e-3
    trajectory = RollOut(environment, np.random.default_rng(0)).collect(policy, 100)
    assert not trajectory.present.all()
    goes_on = np.flatnonzero(~trajectory.last)
    assert np.array_equal(trajectory.next_present[goes_on], trajectory.present[goes_on + 1])
    score = learner.network(decision_batch(trajectory, presence=True))
    assert score.log_prob.detach().numpy() == pytest.approx(trajectory.log_prob, abs=1e-5)
    saved = OptionPolicy(environment.agents, head, False, as_numpy(learner.network), presence=True)
    saved.save(tmp_path / "p.safetensors")
    again = OptionPolicy.load(tmp_path / "p.safetensors")
    assert again.presence
    found = np.exp(again.joint.given(seen, one, nobody).log_prob(np.array([0, NONE])))
    assert found == pytest.approx(alone[0], abs=1e-6)


@pytest.mark.parametrize("head", HEADS)
def test_what_to_do_without_the_other_is_learnt(head):
    environment = OptionEnvironment(Lifting(), 0.9, drop=1.0)
    torch.manual_seed(0)
    learner, generator = Mappo(environment.agents, head, presence=True), np.random.default_rng(0)
    roll_out = RollOut(environment, generator)
    for _ in range(16):
        learner.learn(roll_out.collect(learner.behaviour(0.0), 120), generator)
    policy, nobody, seen = learner.behaviour(1.0), np.array([NONE, NONE]), np.zeros(2)
    assert policy.given(seen, np.array([True, True]), nobody).mode().tolist() == [TOGETHER, TOGETHER]
    assert policy.given(seen, np.array([False, True]), nobody).mode().tolist() == [NONE, ALONE]
    assert policy.given(seen, np.array([True, False]), nobody).mode().tolist() == [ALONE, NONE]


def test_methods_that_have_no_place_for_it_say_so():
    for method in ("partial", "mac_dqn"):
        with pytest.raises(CtrlRlError, match="omit --drop"):
            OptionRun("tool_delivery", method, 0, drop=0.3).learner()
    run = OptionRun("tool_delivery", "async_autoregressive", 0, drop=0.3)
    assert run.name == "tool_delivery-async_autoregressive-drop0.3-s0"
    assert run.policy(run.learner(), {}).presence
    with pytest.raises(CtrlRlError, match="without presence"):
        make_policy("table", {}, (2, 2), True, True)

"""Torch and NumPy policies agree, and the entropy estimates used in learning are unbiased."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from option_coordinator.policies.policy_file import HEADS, make_policy
from option_coordinator.training.heads import heads
from option_coordinator.training.heads.head_parts import DecisionBatch
from option_coordinator.training.heads.heads import as_numpy, make_head
from policies import random_decision

from option_coordinator import NONE, Agent

COUNTS = (3, 2, 4)
AGENTS = tuple(Agent(f"robot_{i}", tuple("abcd"[:count]), 2 + i) for i, count in enumerate(COUNTS))


def random_head(head, partial, seed):
    torch.manual_seed(seed)
    network = make_head(head, AGENTS, partial).double()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    return network


def pair(head, partial, seed):
    network = random_head(head, partial, seed)
    return network, make_policy(head, as_numpy(network), COUNTS, partial)


def one_choice(observation, options, decision):
    choosing, _, legal = decision
    rows = (observation, options, choosing, legal)
    return DecisionBatch(*(torch.from_numpy(np.asarray(row))[None] for row in rows))


@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("head", HEADS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=12, deadline=None)
def test_torch_and_numpy_agree(head, partial, seed):
    generator = np.random.default_rng(seed)
    network, policy = pair(head, partial, seed)
    decision, observation = random_decision(COUNTS, generator), generator.normal(size=9)
    conditional = policy.given(observation, *decision)
    options = conditional.sample(generator)
    score = network(one_choice(observation, options, decision))
    assert score.log_prob.item() == pytest.approx(float(conditional.log_prob(options)), abs=1e-9)
    choices = conditional.choices()
    many = DecisionBatch(
        *(part.expand(len(choices), *part.shape[1:]) for part in one_choice(observation, options, decision))
    )
    scores = network(many._replace(options=torch.from_numpy(choices)))
    assert scores.log_prob.exp().sum().item() == pytest.approx(1.0, abs=1e-9)
    mean = (scores.log_prob.exp() * scores.entropy).sum().item()
    assert mean == pytest.approx(conditional.entropy(), abs=1e-6)


def test_entropies_of_many_robots_are_true_on_average(monkeypatch):
    """Mixture with too many joint options to enumerate; the entropy comes from the chain rule."""
    monkeypatch.setattr(heads, "COUNTABLE", 1)
    generator = np.random.default_rng(0)
    network, policy = pair("mixture", False, 1)
    assert network.cells is None
    decision, observation = random_decision(COUNTS, generator, [True, True, True]), generator.normal(size=9)
    conditional = policy.given(observation, *decision)
    choices = conditional.choices()
    many = DecisionBatch(*(p.expand(len(choices), *p.shape[1:]) for p in one_choice(observation, choices[0], decision)))
    scores = network(many._replace(options=torch.from_numpy(choices)))
    assert (scores.log_prob.exp() * scores.entropy).sum().item() == pytest.approx(conditional.entropy(), abs=1e-6)


@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("head", HEADS)
def test_gradients_are_finite_with_masks_and_running_agents(head, partial):
    generator = np.random.default_rng(7)
    network, policy = pair(head, partial, 7)
    for _ in range(20):
        decision, observation = random_decision(COUNTS, generator), generator.normal(size=9)
        options = policy.given(observation, *decision).sample(generator)
        score = network(one_choice(observation, options, decision))
        (score.log_prob + score.entropy).sum().backward()
    assert all(torch.isfinite(p.grad).all() for p in network.parameters() if p.grad is not None)


def test_the_numpy_policy_learns_along():
    network, policy = pair("table", False, 3)
    everyone, nobody = np.ones(3, dtype=bool), np.full(3, NONE)
    before = policy.given(np.ones(9), everyone, nobody).entropy()
    torch.optim.SGD(network.parameters(), 1.0)
    with torch.no_grad():
        network.head.weight.mul_(0.0)
        network.head.bias.mul_(0.0)
    after = policy.given(np.ones(9), everyone, nobody).entropy()
    assert after == pytest.approx(np.log(24.0))
    assert after > before

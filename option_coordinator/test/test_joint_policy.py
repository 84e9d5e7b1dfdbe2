"""Conditional policies against brute force, for any set of choosing, running and absent agents (Eq. 5.2, 5.3)."""

from hashlib import sha256

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from option_coordinator.policies.joint_policy import ENUMERABLE, draw, log_sum_exp, most_likely
from option_coordinator.policies.policy_file import HEADS, make_policy
from policies import all_joint, brute_force, random_decision, random_policy, random_tensors

from ctrl_rl_core import CtrlRlError
from option_coordinator import NONE, Agent, OptionPolicy

COUNTS = (3, 2, 4)
EXACT = ("table", "mixture")
SEEDS = st.integers(0, 2**32 - 1)
EDGES = [([True] * 3, [False] * 3), ([False] * 3, [False] * 3), ([False] * 3, [True] * 3), ([True, False, False], None)]


def full(policy, observation):
    """Log-probabilities of all joint options, with every agent choosing and every option legal."""
    agents = len(policy.counts)
    everyone = policy.given(observation, np.ones(agents, dtype=bool), np.full(agents, NONE))
    return everyone.log_prob(all_joint(policy.counts))


def check_against_brute_force(policy, observation, choosing, running, legal):
    expected = brute_force(full(policy, observation), policy.counts, choosing, running, legal)
    conditional = policy.given(observation, choosing, running, legal)
    choices = conditional.choices()
    found = {tuple(int(o) for o in c[choosing]): p for c, p in zip(choices, conditional.log_prob(choices), strict=True)}
    assert found.keys() == expected.keys()
    for key, probability in expected.items():
        assert found[key] == pytest.approx(np.log(probability), abs=1e-6)
    probabilities = np.array(list(expected.values()))
    assert conditional.entropy() == pytest.approx(-np.sum(probabilities * np.log(probabilities)), abs=1e-6)
    best = tuple(int(o) for o in conditional.mode()[choosing])
    assert expected[best] == pytest.approx(probabilities.max(), abs=1e-9)


@pytest.mark.parametrize("head", EXACT)
@given(seed=SEEDS)
@settings(max_examples=60, deadline=None)
def test_conditionals_are_those_of_the_joint_policy(head, seed):
    generator = np.random.default_rng(seed)
    policy = random_policy(head, COUNTS, generator)
    check_against_brute_force(policy, generator.normal(size=5), *random_decision(COUNTS, generator))


@pytest.mark.parametrize("head", EXACT)
@pytest.mark.parametrize(("choosing", "absent"), EDGES)
def test_everybody_nobody_and_one_alone(head, choosing, absent):
    generator = np.random.default_rng(1)
    policy = random_policy(head, COUNTS, generator)
    decision = random_decision(COUNTS, generator, choosing, absent)
    check_against_brute_force(policy, generator.normal(size=5), *decision)
    if not any(choosing):
        conditional = policy.given(generator.normal(size=5), *decision)
        assert conditional.log_prob(conditional.sample(generator)) == pytest.approx(0.0, abs=1e-12)
        assert conditional.entropy() == pytest.approx(0.0, abs=1e-12)


def naive_chain(tensors, counts, observation, choosing, running, legal, options):
    """Log pi-hat of the autoregressive policy: a slow, independent implementation."""
    from option_coordinator.policies.network import features, layer_norm, linear

    begin = [sum(counts[:i]) for i in range(len(counts))]
    known = np.zeros(sum(counts))
    for i, option in enumerate(running):
        if option != NONE:
            known[begin[i] + option] = 1.0
    total = 0.0
    for i in range(len(counts)):
        if choosing[i]:
            hidden = linear(tensors, "state", features(tensors, observation)) + tensors["known.weight"] @ known
            logits = linear(tensors, "head", layer_norm(tensors, "norm", np.maximum(hidden, 0.0)))
            own = np.array([logits[begin[i] + k] if legal[i, k] else -np.inf for k in range(counts[i])])
            total += own[options[i]] - np.log(np.exp(own).sum())
            known[begin[i] + options[i]] = 1.0
    return total


@given(seed=SEEDS)
@settings(max_examples=60, deadline=None)
def test_the_chain_is_the_product_of_its_links(seed):
    generator = np.random.default_rng(seed)
    tensors = random_tensors("autoregressive", COUNTS, 5, generator)
    policy = make_policy("autoregressive", tensors, COUNTS, False)
    observation, decision = generator.normal(size=5), random_decision(COUNTS, generator)
    conditional = policy.given(observation, *decision)
    choices = conditional.choices()
    logs = conditional.log_prob(choices)
    expected = [naive_chain(tensors, COUNTS, observation, *decision, options) for options in choices]
    assert logs == pytest.approx(np.array(expected), abs=1e-6)
    assert np.exp(logs).sum() == pytest.approx(1.0, abs=1e-9)
    assert conditional.entropy() == pytest.approx(-np.sum(np.exp(logs) * logs), abs=1e-6)
    assert conditional.log_prob(conditional.mode()) == pytest.approx(logs.max())


@pytest.mark.parametrize("head", HEADS)
@given(seed=SEEDS)
@settings(max_examples=20, deadline=None)
def test_partially_centralised_choosers_do_not_know_each_other(head, seed):
    generator = np.random.default_rng(seed)
    policy = random_policy(head, COUNTS, generator, partial=True)
    observation, (choosing, running, legal) = generator.normal(size=6), random_decision(COUNTS, generator)
    conditional = policy.given(observation, choosing, running, legal)
    choices = conditional.choices()
    expected = np.zeros(len(choices))
    for agent in np.flatnonzero(choosing):
        alone = np.arange(3) == agent
        own = policy._policies[agent].given(observation[2 * agent : 2 * agent + 2], alone, running, legal)
        expected += own.log_prob(choices)
    logs = conditional.log_prob(choices)
    assert logs == pytest.approx(expected, abs=1e-9)
    assert np.exp(logs).sum() == pytest.approx(1.0, abs=1e-9)
    assert conditional.entropy() == pytest.approx(-np.sum(np.exp(logs) * logs), abs=1e-6)
    assert conditional.log_prob(conditional.mode()) == pytest.approx(logs.max())


@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("head", HEADS)
def test_draws_come_as_often_as_they_should(head, partial):
    generator = np.random.default_rng(5)
    policy = random_policy(head, (3, 2, 2), generator, partial, 6)
    choosing, running, legal = random_decision((3, 2, 2), generator, [True, False, True], [False] * 3)
    conditional = policy.given(generator.normal(size=6), choosing, running, legal)
    choices = conditional.choices()
    draws = np.array([conditional.sample(generator) for _ in range(2000)])
    assert np.all(draws[:, 1] == running[1])
    often = np.array([np.mean(np.all(draws == choice, axis=1)) for choice in choices])
    assert often.sum() == pytest.approx(1.0)  # nothing illegal
    assert often == pytest.approx(np.exp(conditional.log_prob(choices)), abs=0.04)


@pytest.mark.parametrize("head", ["mixture", "autoregressive"])
def test_a_hundred_robots(head):
    generator = np.random.default_rng(2)
    counts = (5,) * 100
    policy = random_policy(head, counts, generator)
    choosing, running, legal = random_decision(counts, generator)
    conditional = policy.given(generator.normal(size=5), choosing, running, legal)
    assert conditional.size > ENUMERABLE
    draws = np.array([conditional.sample(generator) for _ in range(100)])
    assert np.all(legal[choosing, :][np.arange(choosing.sum()), draws[:, choosing]])
    assert np.all(conditional.log_prob(conditional.mode()) >= conditional.log_prob(draws))
    assert conditional.entropy() == pytest.approx(-conditional.log_prob(draws).mean(), rel=0.1)


def test_a_mixture_conditions_as_bayes_would_for_many_robots():
    """Check of the chain rule p(a, b) = p(a) p(b | a) where enumeration is infeasible."""
    generator = np.random.default_rng(3)
    counts = (4,) * 60
    policy, observation = random_policy("mixture", counts, generator), generator.normal(size=5)
    choosing, nobody = np.ones(60, dtype=bool), np.full(60, NONE)
    whole = policy.given(observation, choosing, nobody)
    options = whole.sample(generator)
    first = np.arange(60) < 25
    marginal = policy.given(observation, first, nobody).log_prob(options)  # the others absent
    rest = policy.given(observation, ~first, np.where(first, options, NONE)).log_prob(options)
    assert whole.log_prob(options) == pytest.approx(marginal + rest, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"observation": np.zeros(4)}, "shape"),
        ({"observation": np.array([0.0, np.nan, 0.0, 0.0, np.inf])}, "2 numbers are not finite"),
        ({"choosing": np.ones(2, dtype=bool)}, "shapes"),
        ({"running": np.array([NONE, 2, NONE])}, "below"),
        ({"legal": np.ones((3, 3), dtype=bool)}, r"legal has shape \(3, 3\), must be \(3, 4\)"),
        ({"legal": np.ones(4, dtype=bool)}, r"legal has shape \(4,\), must be \(3, 4\)"),
        ({"legal": np.zeros((3, 4), dtype=bool)}, "agent 0 has no legal option"),
    ],
)
def test_nonsense_is_refused(change, words):
    policy = random_policy("table", COUNTS, np.random.default_rng(0))
    right = {
        "observation": np.zeros(5),
        "choosing": np.array([True, False, True]),
        "running": np.array([NONE, 1, NONE]),
    }
    with pytest.raises(CtrlRlError, match=words):
        policy.given(**(right | change))


def test_sums_of_exponentials_at_the_edges():
    assert log_sum_exp(np.array([-np.inf, -np.inf])) == -np.inf
    assert log_sum_exp(np.array([1e4, 1e4])) == pytest.approx(1e4 + np.log(2.0))
    logs = np.array([-np.inf, 0.0, -np.inf])
    assert {int(draw(logs, np.random.default_rng(i))) for i in range(50)} == {1}


@pytest.mark.parametrize("head", HEADS)
def test_a_file_gives_back_the_policy(tmp_path, head):
    generator = np.random.default_rng(4)
    agents = tuple(Agent(f"robot_{i}", tuple("abcd"[:count]), 2) for i, count in enumerate(COUNTS))
    policy = OptionPolicy(agents, head, False, random_tensors(head, COUNTS, 6, generator), manifest={"task": "x"})
    policy.save(tmp_path / "p.safetensors")
    again = OptionPolicy.load(tmp_path / "p.safetensors")
    assert again.agents == agents
    assert again.manifest == {"task": "x"}
    assert again.digest == policy.digest == sha256((tmp_path / "p.safetensors").read_bytes()).hexdigest()
    choosing, running, legal = random_decision(COUNTS, generator)
    one, other = (p.joint.given(np.ones(6), choosing, running, legal) for p in (policy, again))
    assert np.array_equal(one.log_prob(one.choices()), other.log_prob(one.choices()))


def test_files_that_are_no_policies_are_named(tmp_path):
    path = tmp_path / "p.safetensors"
    with pytest.raises(CtrlRlError, match=r"p\.safetensors"):
        OptionPolicy.load(path)
    path.write_bytes(b"nonsense")
    with pytest.raises(CtrlRlError, match=r"p\.safetensors"):
        OptionPolicy.load(path)
    agents = (Agent("a", ("x", "y"), 3),)
    OptionPolicy(agents, "table", False, random_tensors("table", (2,), 4, np.random.default_rng(0))).save(path)
    with pytest.raises(CtrlRlError, match="observes 4 numbers, its agents 3"):
        OptionPolicy.load(path)


@pytest.mark.parametrize("head", HEADS)
@pytest.mark.parametrize("partial", [False, True])
def test_policies_that_could_not_choose_are_refused_when_they_are_read(tmp_path, head, partial):
    path, generator = tmp_path / "p.safetensors", np.random.default_rng(0)
    agents = tuple(Agent(f"robot_{i}", tuple("abcd"[:count]), 2) for i, count in enumerate(COUNTS))
    right = {}
    for i in range(3) if partial else [0]:
        own = random_tensors(head, COUNTS, 2 if partial else 6, generator)
        right |= {f"{i}.{name}" if partial else name: tensor for name, tensor in own.items()}
    last = "2." if partial else ""
    OptionPolicy(agents, head, partial, right).save(path)
    OptionPolicy.load(path)
    nan = right | {f"{last}head.bias": np.full_like(right[f"{last}head.bias"], np.nan)}
    OptionPolicy(agents, head, partial, nan).save(path)
    with pytest.raises(CtrlRlError, match=r"p\.safetensors: not all numbers of '(2\.)?head\.bias' are finite"):
        OptionPolicy.load(path)
    for name in ("head.bias", "trunk.linear_2.weight"):
        broken = right | {f"{last}{name}": right[f"{last}{name}"][:-1]}
        OptionPolicy(agents, head, partial, broken).save(path)
        with pytest.raises(CtrlRlError, match=r"p\.safetensors: its tensors do not match"):
            OptionPolicy.load(path)


@pytest.mark.parametrize("head", HEADS)
def test_weights_that_are_not_numbers_choose_nothing(head):
    """In particular not option 0, which may be illegal."""
    tensors = random_tensors(head, COUNTS, 5, np.random.default_rng(0))
    tensors["head.bias"][:] = np.nan
    policy = make_policy(head, tensors, COUNTS, False)
    conditional = policy.given(np.zeros(5), np.ones(3, dtype=bool), np.full(3, NONE))
    with pytest.raises(CtrlRlError, match="not finite"):
        conditional.sample(np.random.default_rng(0))
    with pytest.raises(CtrlRlError, match="not finite"):
        conditional.mode()
    with pytest.raises(CtrlRlError, match="not finite"):
        most_likely(np.array([0.0, np.nan]))

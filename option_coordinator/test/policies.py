"""Random joint policies and decisions, with brute-force reference values."""

from itertools import product

import numpy as np
from option_coordinator.options.options import option_mask
from option_coordinator.policies.policy_file import make_policy

from option_coordinator import NONE

HIDDEN = 12
RANK = 3


def random_tensors(head, counts, observation_size, generator, scale=1.0):
    """Tensors of a policy far from uniform."""

    def layer(name, out, inputs):
        return {
            f"{name}.weight": scale * generator.normal(size=(out, inputs)),
            f"{name}.bias": scale * generator.normal(size=out),
        }

    def norm(name, size):
        return {f"{name}.weight": 1.0 + 0.1 * generator.normal(size=size), f"{name}.bias": generator.normal(size=size)}

    tensors = norm("trunk.norm_0", observation_size)
    for number, inputs in ((1, observation_size), (2, HIDDEN)):
        tensors |= layer(f"trunk.linear_{number}", HIDDEN, inputs) | norm(f"trunk.norm_{number}", HIDDEN)
    total = sum(counts)
    if head == "table":
        return tensors | layer("head", int(np.prod(counts)), HIDDEN)
    if head == "mixture":
        return tensors | layer("weights", RANK, HIDDEN) | layer("head", RANK * total, HIDDEN)
    known = {"known.weight": generator.normal(size=(HIDDEN, total))}
    return tensors | layer("state", HIDDEN, HIDDEN) | known | norm("norm", HIDDEN) | layer("head", total, HIDDEN)


def random_policy(head, counts, generator, partial=False, observation_size=5):
    """Random policy of any kind; a partial one observes 2 numbers per agent."""
    if not partial:
        return make_policy(head, random_tensors(head, counts, observation_size, generator), counts, False)
    tensors = {}
    for agent in range(len(counts)):
        own = random_tensors(head, counts, 2, generator)
        tensors |= {f"{agent}.{name}": tensor for name, tensor in own.items()}
    return make_policy(head, tensors, counts, True)


def random_decision(counts, generator, choosing=None, absent=None, all_legal=False):
    """Random choosers, running options and legal options."""
    agents = len(counts)
    choosing = generator.random(agents) < 0.6 if choosing is None else np.array(choosing)
    absent = ~choosing & (generator.random(agents) < 0.3) if absent is None else np.array(absent)
    running = np.array([generator.integers(count) for count in counts])
    running[choosing | absent] = NONE
    legal = option_mask(counts)
    if not all_legal:
        kept = legal & (generator.random(legal.shape) < 0.6)
        legal = np.where(kept.any(axis=1, keepdims=True), kept, legal)
    return choosing, running, legal


def all_joint(counts):
    """All joint options (cells, N)."""
    return np.array(list(product(*(range(count) for count in counts))))


def brute_force(joint_log_prob, counts, choosing, running, legal):
    """Return the choosers' joint options and their probabilities by summing over all joint options."""
    weights = {}
    for options, log_prob in zip(all_joint(counts), joint_log_prob, strict=True):
        fits = all(running[i] in (NONE, options[i]) for i in range(len(counts)) if not choosing[i])
        allowed = all(legal[i, options[i]] for i in range(len(counts)) if choosing[i])
        if fits and allowed:
            key = tuple(int(o) for o in options[choosing])
            weights[key] = weights.get(key, 0.0) + np.exp(log_prob)
    total = sum(weights.values())
    return {key: weight / total for key, weight in weights.items()}

"""Joint policies as networks for export: the joint distribution, and each agent's exact conditional."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ctrl_rl_core import PolicyDescription, networks
from option_coordinator.errors import OptionError
from option_coordinator.options.options import NONE
from option_coordinator.policies.joint_policy import Array
from option_coordinator.policies.network import Tensors
from option_coordinator.policies.policy_file import OptionPolicy

JOINT = "joint"
_TRIED = 4
"""Number of the others' running options with which each agent's conditional is compared, per observation."""
_REMARKS = (
    "No node drives by it: a coordinator grants its options. The outputs are natural logarithms of probabilities, with "
    "one axis per agent and no option ruled out.",
    "`joint` is the distribution over all agents' options. The output with an agent's name is its distribution given "
    "the options of all others, along its own axis. For several agents that choose at once, subtract from `joint` its "
    "log-sum-exp over their axes; to rule options out, set them to minus infinity first.",
)


def describe_policy(path: Path | str) -> PolicyDescription:
    """Describe the policy of a file for export.

    Raises:
        OptionError: As for `OptionPolicy.load`, or the policy is not one table over joint options.
    """
    policy = OptionPolicy.load(path)
    if policy.head != "table" or policy.partial or policy.presence:
        kind = "partial" if policy.partial else "with presence" if policy.presence else policy.head
        raise OptionError(f"{path}: a joint policy of kind '{kind}' cannot be exported: only one table can")
    counts = tuple(len(agent.options) for agent in policy.agents)
    table, names = networks.Table(counts), [agent.name for agent in policy.agents]
    heads: dict[str, tuple[networks.Layer, ...]] = {JOINT: (networks.LogSoftmax(1), table)}
    heads |= {name: (table, networks.LogSoftmax(1 + axis)) for axis, name in enumerate(names)}
    generator = np.random.default_rng(0)

    def outputs(observation: Array) -> dict[str, Array]:
        everyone = np.ones(len(counts), dtype=bool)
        given = policy.joint.given(observation, everyone, np.full(len(counts), NONE))
        found = {JOINT: np.asarray(given.log_prob(given.choices())).reshape(counts)}
        for agent, name in enumerate(names):
            found[name] = _conditionals(policy, observation, agent, generator)
        return found

    trunk = tuple(_trunk(policy.tensors))
    size = policy.joint.observation_size
    return PolicyDescription(networks.Network(size, trunk, heads), outputs, policy.manifest, remarks=_REMARKS)


def _trunk(tensors: Tensors) -> Iterator[networks.Layer]:
    """Yield the layers from the observation to the table's logits."""
    yield _norm(tensors, 0)
    for index in (1, 2):
        yield _dense(tensors, f"trunk.linear_{index}")
        yield networks.Pointwise("relu")
        yield _norm(tensors, index)
    yield _dense(tensors, "head")


def _norm(tensors: Tensors, index: int) -> networks.Normalise:
    return networks.Normalise(tensors[f"trunk.norm_{index}.weight"], tensors[f"trunk.norm_{index}.bias"])


def _dense(tensors: Tensors, name: str) -> networks.Dense:
    return networks.Dense(tensors[f"{name}.weight"], tensors[f"{name}.bias"])


def _conditionals(policy: OptionPolicy, observation: Array, agent: int, generator: np.random.Generator) -> Array:
    """Return an agent's log-probabilities (K_0, ..., K_N-1) for some of the others' options; NaN for the rest."""
    counts = policy.joint.counts
    found = np.full(counts, np.nan)
    alone = np.arange(len(counts)) == agent
    for _ in range(_TRIED):
        running = generator.integers(counts)
        given = policy.joint.given(observation, alone, running)
        options = np.tile(running, (counts[agent], 1))
        options[:, agent] = np.arange(counts[agent])
        place = tuple(slice(None) if own else int(option) for own, option in zip(alone, running, strict=True))
        found[place] = given.log_prob(options)
    return found

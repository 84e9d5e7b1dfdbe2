"""What a policy would earn, from transitions of other drivers.

Fitted Q evaluation: Le, Voloshin, Yue 2019. Weighted doubly robust evaluation: Thomas, Brunskill 2016, for
deterministic policies and an unknown driver, who is taken for a normal distribution around what was cloned from him.
The policy counts as a narrow normal distribution around its command, since it never does exactly what was recorded.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import mse_loss

from ctrl_rl_core import Actor
from ctrl_rl_learning.offline.data.transitions import Transitions
from ctrl_rl_learning.offline.learners.learning import batches, scales_of
from ctrl_rl_learning.torch.networks import Critics
from ctrl_rl_learning.torch.optimization import gradient_step, polyak_update

Array = NDArray[np.float64]
_BATCH, _HIDDEN, _RATE, _TAU = 128, 64, 1e-3, 0.1


@dataclass(frozen=True)
class PolicyValues:
    """Values of a policy at the transitions of bags, by one fit; in the task's reward.

    Attributes:
        before: Value of the policy's own command at each observation (N,).
        given: Value of the command that was given there (N,).
        after: Value of the policy's own command at what followed (N,), 0 where the episode ended.
    """

    before: Array
    given: Array
    after: Array


def actions_of(actor: Actor, observations: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the actions (N, 2) of a policy at observations (N, n) in SI units."""
    x = (observations - actor.middle) / actor.unit
    kind = actor.activation.removeprefix("normalized_")
    for index, (weight, bias) in enumerate(zip(actor.weights, actor.biases, strict=True)):
        x = x @ weight.T + bias
        if index < len(actor.weights) - 1:
            if kind != actor.activation:
                x = (x - x.mean(axis=1, keepdims=True)) / np.sqrt(x.var(axis=1, keepdims=True) + 1e-5)
            x = np.tanh(x) if kind == "tanh" else np.maximum(x, 0.0)
    return np.asarray(np.tanh(x) if actor.squashed else np.clip(x, -1.0, 1.0), dtype=np.float32)


def fit_values(
    transitions: Transitions,
    actor: Actor,
    discount: float,
    updates: int,
    seed: int,
    bounds: tuple[float, float],
    known: NDArray[np.bool_] | None = None,
    tell: Callable[[int], object] = lambda _: None,
) -> PolicyValues:
    """Return the values of a policy, fitted to transitions by the task's own rewards.

    Targets are cut off at the bounds, which keeps a fit from running away where the bags say nothing. What follows an
    action that the bags do not know is worth the least: a fit is extrapolated there.

    Args:
        transitions: Transitions of the driver.
        actor: Policy.
        discount: Discount of a step.
        updates: Number of updates of the networks.
        seed: Seed of weights and batches.
        bounds: Least and largest return that an episode can still pay.
        known: Whether the bags know the policy's action at what followed (N,); all of them unless given.
        tell: Told the number of updates since the last call.
    """
    middle, unit = scales_of(transitions.observations)
    scale = max(abs(bounds[0]), abs(bounds[1])) or 1.0
    seen, following = ((each - middle) / unit for each in (transitions.observations, transitions.next_observations))
    own = actions_of(actor, transitions.observations), actions_of(actor, transitions.next_observations)
    unknown = np.zeros(len(transitions)) if known is None else ~known
    arrays = (seen, transitions.actions, transitions.task_rewards / scale, following, own[1], transitions.done, unknown)
    tensors = tuple(torch.from_numpy(np.asarray(array, dtype=np.float32)) for array in arrays)
    least, most = bounds[0] / scale, bounds[1] / scale
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        critics = Critics(len(middle), _HIDDEN)
        slow = copy.deepcopy(critics)
        optimizer = torch.optim.Adam(critics.parameters(), lr=_RATE, fused=True)
        for s, a, paid, after, command, ended, lost in batches(tensors, _BATCH, updates, np.random.default_rng(seed)):
            with torch.no_grad():
                worth = torch.where(lost > 0.0, least, _mean(slow, after, command).clamp(least, most))
                target = paid + discount * (1.0 - ended) * worth
            first, second = critics(s, a)
            loss = mse_loss(first, target) + mse_loss(second, target)
            gradient_step(optimizer, loss)
            polyak_update(slow, critics, _TAU)
            tell(1)
    with torch.no_grad():
        before = _mean(slow, tensors[0], torch.from_numpy(own[0]))
        given = _mean(slow, tensors[0], tensors[1])
        after = _mean(slow, tensors[3], tensors[4]) * (1.0 - tensors[5])
    clipped = (each.clamp(least, most).numpy().astype(np.float64) * scale for each in (before, given, after))
    return PolicyValues(*clipped)


def _mean(critics: Critics, observations: Tensor, actions: Tensor) -> Tensor:
    first, second = critics(observations, actions)
    return 0.5 * (first + second)


_LARGEST_RATIO = 3.0
_WIDTH = 0.7
"""Width of the policy's distribution over the driver's."""


def step_ratios(transitions: Transitions, cloned: NDArray[np.float32], own: NDArray[np.float32]) -> Array:
    """Return how much likelier each command was under the policy than under the driver (N,), cut off.

    Args:
        transitions: Transitions of the driver.
        cloned: Actions (N, 2) of a clone of the driver.
        own: Actions (N, 2) of the policy.
    """
    spread = np.maximum((transitions.actions - cloned).std(axis=0), 0.05)
    width = _WIDTH * spread
    driver = -0.5 * (((transitions.actions - cloned) / spread) ** 2).sum(axis=1) - np.log(spread).sum()
    policy = -0.5 * (((transitions.actions - own) / width) ** 2).sum(axis=1) - np.log(width).sum()
    return np.asarray(np.minimum(np.exp(np.minimum(policy - driver, 10.0)), _LARGEST_RATIO), dtype=np.float64)


def episode_estimates(
    transitions: Transitions, values: PolicyValues, ratios: Array, discount: float
) -> tuple[Array, float]:
    """Return the estimate of each episode (episodes,), whose mean is the policy's return, and the effective episodes.

    Each begins with the fitted value of its first observation; what followed corrects it, weighted by how likely the
    policy would have done the same so far. The weights of a step are scaled to a mean of 1 over the episodes.
    """
    starts = np.flatnonzero(transitions.first)
    number = np.cumsum(transitions.first) - 1
    step = np.arange(len(transitions)) - starts[number]
    logs = np.log(np.maximum(ratios, 1e-12))
    total = np.cumsum(logs)
    weights = np.exp(total - (total - logs)[starts][number])
    sums = np.bincount(step, weights)
    # Episodes that are over count with their last weight, so that long ones do not gain from being the only ones left.
    ends = np.append(starts[1:], len(transitions)) - 1
    over = np.zeros(len(sums) + 1)
    np.add.at(over, step[ends] + 1, weights[ends])
    means = np.maximum((sums + np.cumsum(over)[:-1]) / len(starts), 1e-12)
    weights = weights / means[step]
    error = transitions.task_rewards + discount * values.after - values.given
    corrections = np.add.reduceat(weights * discount**step * error, starts)
    last = weights[ends]
    effective = float(last.sum() ** 2 / max(float((last**2).sum()), 1e-12))
    return values.before[starts] + corrections, effective

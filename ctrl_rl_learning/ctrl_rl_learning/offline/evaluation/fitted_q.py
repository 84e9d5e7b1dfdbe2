"""Fitted Q evaluation (Le, Voloshin, Yue 2019): what a policy would earn, from transitions of other drivers."""

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
from ctrl_rl_learning.offline.learners.batches import batches, scales_of
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
    tell: Callable[[int], object] = lambda _: None,
) -> PolicyValues:
    """Return the values of a policy, fitted to transitions by the task's own rewards.

    Targets are cut off at the most and the least that an episode can still pay, which keeps a fit from running away
    where the bags say nothing.
    """
    middle, unit = scales_of(transitions.observations)
    scale = float(np.abs(transitions.task_rewards).max(initial=0.0)) or 1.0
    seen, following = ((each - middle) / unit for each in (transitions.observations, transitions.next_observations))
    own = actions_of(actor, transitions.observations), actions_of(actor, transitions.next_observations)
    arrays = (seen, transitions.actions, transitions.task_rewards / scale, following, own[1], transitions.done)
    tensors = tuple(torch.from_numpy(np.asarray(array, dtype=np.float32)) for array in arrays)
    least, most = (
        float(transitions.task_rewards.min(initial=0.0)) / scale,
        float(transitions.task_rewards.max(initial=0.0)) / scale,
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        critics = Critics(len(middle), _HIDDEN)
        slow = copy.deepcopy(critics)
        optimizer = torch.optim.Adam(critics.parameters(), lr=_RATE, fused=True)
        for s, a, paid, after, command, ended in batches(tensors, _BATCH, updates, np.random.default_rng(seed)):
            with torch.no_grad():
                worth = _mean(slow, after, command).clamp(least, most)
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

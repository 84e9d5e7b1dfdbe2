"""Accuracy of policy gradients estimated from few samples, with different baselines (thesis Table 3.7).

The policy is an early one that reaches the goal in about half of the episodes. The thesis uses one that reaches goal
and trap equally often; the trap of `quad_trap` is hardly ever reached (its minimum thrust, 14 N, exceeds the weight),
so crashes take its place. The "true" gradient is Eq. 3.14 over very many samples without b; estimates use fewer,
separate samples and are compared by cosine similarity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from ctrl_rl_learning.sb3 import ROLL_OUT, Recorder
from ctrl_rl_learning.torch import gradient_step
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from oc_baseline_node.errors import OcError
from oc_baseline_node.training.baselines.control_variates import make_critic
from oc_baseline_node.training.experiments.runs import OcRun

_LIMIT = 150
"""Maximum number of roll-outs in the search."""
_SHARE = (1.0 / 3.0, 2.0 / 3.0)
"""Minimum and maximum fraction of the episodes that end in the goal."""


def find_early_policy(
    run: OcRun, progress: Callable[[], object] = lambda: None
) -> tuple[BaseAlgorithm, dict[str, int]]:
    """Train until about half of a roll-out's episodes reach the goal.

    Args:
        run: Run to train.
        progress: Called after each roll-out.

    Returns:
        The algorithm in that state, and the outcomes of the last roll-out's episodes.

    Raises:
        OcError: That never happens.
    """
    model: Any = run.model(ROLL_OUT * _LIMIT)
    model.set_random_seed(run.seed)
    for _ in range(_LIMIT):
        recorder = Recorder()
        model.learn(ROLL_OUT, callback=recorder, reset_num_timesteps=False)
        progress()
        ended = recorder.outcomes
        if _SHARE[0] <= ended.count("GOAL") / max(1, len(ended)) <= _SHARE[1]:
            return model, {name: ended.count(name) for name in sorted(set(ended))}
    model.env.close()
    raise OcError(f"no early policy of {run.name} meets the goal about every second time: try another seed")


Array = NDArray[np.float32]
SIZES = (2**7, 2**9, 2**11, 2**13, 2**15)
"""Sample sizes of Table 3.7."""
TRUTH = 102_400
"""Number of samples of the true gradient."""
POOL = 4 * max(SIZES)
"""Number of samples from which estimates are drawn, enough for the largest estimates to differ."""
_EPOCHS = 20
_BATCH = 256


class Samples(NamedTuple):
    """Samples of one policy, whole episodes only.

    Attributes:
        observations: Observations of the policy (N, d).
        actions: Actions of the policy (N, m).
        returns: Discounted return from each sample to the end of its episode (N,): G for lambda = 1.
        outcomes: Outcome of each episode, by name.
    """

    observations: Array
    actions: Array
    returns: Array
    outcomes: list[str]


def collect_samples(
    policy: Any, environments: VecEnv, count: int, discount: float, progress: Callable[[int], object] = lambda _: None
) -> Samples:
    """Return at least `count` samples of whole episodes; `progress` is called with the numbers of new samples."""
    observations: Any = environments.reset()
    open_: list[list[tuple[Array, Array, float]]] = [[] for _ in range(environments.num_envs)]
    parts: list[tuple[Array, Array, Array]] = []
    outcomes: list[str] = []
    got = 0
    while got < count:
        with torch.no_grad():
            actions = policy.get_distribution(torch.from_numpy(observations)).get_actions().numpy()
        following: Any
        following, rewards, dones, infos = environments.step(np.clip(actions, -1.0, 1.0))
        for index, steps in enumerate(open_):
            steps.append((observations[index].copy(), actions[index], float(rewards[index])))
            if dones[index]:
                parts.append(_episode(steps, discount))
                outcomes.append(infos[index]["outcome"])
                got += len(steps)
                progress(len(steps))
                open_[index] = []
        observations = following
    first, second, third = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Samples(first, second, third, outcomes)


def _episode(steps: list[tuple[Array, Array, float]], discount: float) -> tuple[Array, Array, Array]:
    returns, after = np.empty(len(steps), dtype=np.float32), 0.0
    for index in reversed(range(len(steps))):
        after = steps[index][2] + discount * after
        returns[index] = after
    return np.array([step[0] for step in steps]), np.array([step[1] for step in steps]), returns


def policy_gradient(policy: Any, samples: Samples, baseline: Array | None, chosen: NDArray[np.int64]) -> Array:
    """Return the estimate of Eq. 3.14 (parameters,) from the samples `chosen`, with b (N,) or without."""
    parameters = actor_parameters(policy)
    total = torch.zeros(sum(parameter.numel() for parameter in parameters))
    signal = samples.returns if baseline is None else samples.returns - baseline
    for part in np.array_split(chosen, max(1, len(chosen) // 8192)):
        distribution = policy.get_distribution(torch.from_numpy(samples.observations[part]))
        log_probability = distribution.log_prob(torch.from_numpy(samples.actions[part]))
        loss = (log_probability * torch.from_numpy(signal[part])).sum()
        total += torch.cat([part.flatten() for part in torch.autograd.grad(loss, parameters)])
    gradient: Array = (total / len(chosen)).numpy()
    return gradient


def actor_parameters(policy: Any) -> list[nn.Parameter]:
    """Return the parameters that affect the policy's actions."""
    return [*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters(), policy.log_std]


def fit_value(samples: Samples, seed: int) -> Callable[[Array], Array]:
    """Return V of the samples' policy, fitted to the returns by a network of the policy's shape."""
    torch.manual_seed(seed)
    network = make_critic(samples.observations.shape[1])
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
    x, y = torch.from_numpy(samples.observations), torch.from_numpy(samples.returns)
    for _ in range(_EPOCHS):
        for part in torch.split(torch.randperm(len(x)), _BATCH):
            loss = nn.functional.mse_loss(network(x[part]).flatten(), y[part])
            gradient_step(optimizer, loss)

    def value(observations: Array) -> Array:
        with torch.no_grad():
            out: Array = network(torch.from_numpy(observations)).flatten().numpy()
            return out

    return value


def similarities(
    policy: Any,
    truth: Array,
    samples: Samples,
    baselines: Mapping[str, Array | None],
    random: np.random.Generator,
    repeats: int = 20,
) -> dict[str, dict[int, list[float]]]:
    """Return cosine similarities of estimates to the true gradient, by baseline and sample size, `repeats` each.

    All baselines use the same samples.
    """
    out: dict[str, dict[int, list[float]]] = {name: {size: [] for size in SIZES} for name in baselines}
    for size in SIZES:
        for _ in range(repeats):
            chosen = random.choice(len(samples.returns), min(size, len(samples.returns)), replace=False)
            for name, baseline in baselines.items():
                out[name][size].append(cosine(policy_gradient(policy, samples, baseline, chosen), truth))
    return out


def cosine(a: Array, b: Array) -> float:
    """Return the cosine of the angle between two vectors."""
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))

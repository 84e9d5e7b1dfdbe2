"""The time to reach as prior knowledge: V as baseline or initial critic, and demonstrations of its greedy control."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from ctrl_rl_learning.sb3 import REWARD_SCALE, FleetEnvironments, observation_scales
from ctrl_rl_learning.torch import gradient_step
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm

from ctrl_rl_core import NavigationTask
from ttr_reward_node import TimeToReach

_STATES, _STEPS, _BATCH, _RATE = 8192, 600, 256, 1e-3


class TimeToReachBaseline:
    """V of the state inside an observation, in units of the learner's reward; 0 where the goal is unreachable.

    Args:
        potential: Time to reach of the task.
        task: Task of the observations, scaled as in `ctrl_rl_learning.sb3.environment`.
        gamma: Discount of a step.
    """

    def __init__(self, potential: TimeToReach, task: NavigationTask, gamma: float) -> None:
        self._potential, self._gamma = potential, gamma
        self._time_step, self._goal = task.episode.time_step, REWARD_SCALE * task.rewards.goal
        middle, unit = observation_scales(task)
        count = potential.domain.shape[1]
        self._middle, self._unit = middle[:count], unit[:count]

    def __call__(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return V (N,) for observations (N, d)."""
        states = observations[:, : len(self._unit)].astype(float) * self._unit + self._middle
        steps = self._potential.times(states.astype(np.float64)) / self._time_step
        return (self._goal * self._gamma**steps).astype(np.float32)


def fit_critic(model: BaseAlgorithm, baseline: TimeToReachBaseline, seed: int) -> None:
    """Fit the critic of an untrained policy-gradient learner to V, on observations of random roll-outs."""
    policy: torch.nn.Module = model.policy
    environments = model.env
    assert environments is not None
    random = np.random.default_rng(seed)
    environments.seed(seed)
    seen = [np.asarray(environments.reset())]
    while len(seen) * len(seen[0]) < _STATES:
        actions = random.uniform(-1.0, 1.0, (len(seen[0]), 2)).astype(np.float32)
        seen.append(np.asarray(environments.step(actions)[0]))
    observations = np.concatenate(seen).astype(np.float32)
    inputs, wanted = torch.from_numpy(observations), torch.from_numpy(baseline(observations))[:, None]
    learnt = [each for name, each in policy.named_parameters() if "value_net" in name]
    optimizer = torch.optim.Adam(learnt, lr=_RATE)
    for _ in range(_STEPS):
        chosen = torch.from_numpy(random.integers(len(inputs), size=_BATCH))
        loss = torch.nn.functional.mse_loss(policy.predict_values(inputs[chosen]), wanted[chosen])  # type: ignore[operator]
        gradient_step(optimizer, loss)


SAMPLES = 2048
"""Number of demonstration samples, which count as samples of the run."""
_CLONING_STEPS, _CONTROLS = 1500, 5


def demonstrate(
    environments: FleetEnvironments, task: NavigationTask, potential: TimeToReach, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return observations (N, d) and actions (N, 2) of the control that minimises the time to reach one step ahead."""
    system = task.system.build()
    shares = np.linspace(-1.0, 1.0, _CONTROLS)
    actions = np.stack(np.meshgrid(shares, shares, indexing="ij"), axis=-1).reshape(-1, 2)
    low, high = np.array(list(task.robot.commands.values())).T
    controls = low + 0.5 * (actions + 1.0) * (high - low)
    environments.seed(seed)
    observations: Any = environments.reset()
    seen: list[NDArray[np.float32]] = []
    done: list[NDArray[np.float32]] = []
    while sum(map(len, seen)) < SAMPLES:
        chosen = []
        for state in environments.states():
            ends = np.broadcast_to(state, (len(controls), len(state))).copy()
            for _ in range(5):
                ends = system.step(ends, controls, dt=0.2 * task.episode.time_step)
            chosen.append(actions[int(np.argmin(potential.times(ends)))])
        seen.append(observations)
        done.append(np.array(chosen, dtype=np.float32))
        observations = environments.step(done[-1])[0]
    return np.concatenate(seen), np.concatenate(done)


def teach(model: BaseAlgorithm, seen: NDArray[np.float32], done: NDArray[np.float32], seed: int) -> None:
    """Fit the mean action of a policy-gradient learner to demonstrations."""
    policy = model.policy
    random = np.random.default_rng(seed)
    inputs, wanted = torch.from_numpy(seen), torch.from_numpy(done)
    learnt = [each for name, each in policy.named_parameters() if "policy_net" in name or "action_net" in name]
    optimizer = torch.optim.Adam(learnt, lr=_RATE)
    for _ in range(_CLONING_STEPS):
        chosen = torch.from_numpy(random.integers(len(inputs), size=_BATCH))
        mean = policy.get_distribution(inputs[chosen]).distribution.mean  # type: ignore[operator]
        loss = torch.nn.functional.mse_loss(mean, wanted[chosen])
        gradient_step(optimizer, loss)

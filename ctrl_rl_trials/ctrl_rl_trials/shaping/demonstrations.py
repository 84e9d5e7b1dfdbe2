"""Demonstrations by the greedy control of the time to reach, and a policy that is taught by them before it learns."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from ctrl_rl_learning.sb3 import FleetEnvironments
from ctrl_rl_learning.torch import gradient_step
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm

from ctrl_rl_core import NavigationTask
from ttr_reward_node import TimeToReach

SAMPLES = 2048
"""Samples of demonstrations, which count as samples of the run."""
_STEPS, _BATCH, _RATE, _CONTROLS = 1500, 256, 1e-3, 5


def demonstrate(
    environments: FleetEnvironments, task: NavigationTask, potential: TimeToReach, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return observations (N, d) and actions (N, 2) of the control with the least time to reach a step ahead."""
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
    """Fit the mean of a policy gradient's actions to demonstrations."""
    policy = model.policy
    random = np.random.default_rng(seed)
    inputs, wanted = torch.from_numpy(seen), torch.from_numpy(done)
    learnt = [each for name, each in policy.named_parameters() if "policy_net" in name or "action_net" in name]
    optimizer = torch.optim.Adam(learnt, lr=_RATE)
    for _ in range(_STEPS):
        chosen = torch.from_numpy(random.integers(len(inputs), size=_BATCH))
        mean = policy.get_distribution(inputs[chosen]).distribution.mean  # type: ignore[operator]
        loss = torch.nn.functional.mse_loss(mean, wanted[chosen])
        gradient_step(optimizer, loss)

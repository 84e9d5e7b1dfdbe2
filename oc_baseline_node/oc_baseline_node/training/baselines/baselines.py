"""Baselines b(s) of policy gradients (thesis Eq. 3.14): any function of observations, and V_oc as one of them."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from ctrl_rl_learning.sb3.algorithms import REWARD_SCALE
from ctrl_rl_learning.sb3.environment import observation_scales
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask
from oc_baseline_node.errors import OcError
from oc_baseline_node.values.mlp_value import MlpValue

Observations = NDArray[np.float32]
Values = NDArray[np.float32]


class Baseline(Protocol):
    """A function of the observation alone: whatever it is, the gradient of Eq. 3.14 keeps its mean."""

    def __call__(self, observations: Observations) -> Values:
        """Return b (N,), in units of the learner's reward, for observations (N, d)."""


class OcBaseline:
    """V_oc of the state that is part of an observation (x_k of s_k), in units of the learner's reward.

    Args:
        value: Optimal control value V_oc of the task, over the task's states.
        task: whose observations are given, as `ctrl_rl_learning.sb3.environment` scales them.
        noise: standard deviation of what is added to each component of x_k before V_oc is asked, in SI units
            (thesis Fig. 3.16); drawn from torch's generator, which a run seeds.

    Raises:
        OcError: the value has other states than the task.
    """

    def __init__(self, value: MlpValue, task: NavigationTask, noise: float = 0.0) -> None:
        if value.state_names != task.system.build().state_names:
            raise OcError(f"V_oc of task '{value.task}' has other states than task '{task.name}': fit it for this task")
        middle, unit = observation_scales(task)
        # A policy is asked for an action only where the episode goes on: the steps of V_oc to what a collision pays
        # would be met where its set, of a disc, is larger than the body.
        value = value.without_collisions()
        self._value, self._count, self._noise = value, len(value.state_names), noise
        self._middle, self._unit = middle[: self._count], unit[: self._count]

    def states(self, observations: Observations) -> NDArray[np.float64]:
        """Return the states (N, n) [SI units] that are part of observations (N, d)."""
        return observations[:, : self._count].astype(np.float64) * self._unit + self._middle

    def __call__(self, observations: Observations) -> Values:
        """Return b (N,) for observations (N, d)."""
        states = self.states(observations)
        if self._noise > 0.0:
            states += self._noise * torch.randn(states.shape, dtype=torch.float64).numpy()
        return (REWARD_SCALE * self._value.value(self._value.clipped(states))).astype(np.float32)

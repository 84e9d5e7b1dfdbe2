"""Policy gradients of Stable-Baselines3 with any baseline (thesis Eq. 3.14): computes A = G^lambda - b(s).

    PPO(BaselinePolicy, env, policy_kwargs={"baseline": b}, vf_coef=0.0)            b also bootstraps G^lambda
    PPO("MlpPolicy", env, rollout_buffer_class=BaselineBuffer,
        rollout_buffer_kwargs={"baseline": b})                                      the learnt V bootstraps G^lambda
    PPO(CorrectedPolicy, env, policy_kwargs={"baseline": b})                        the learnt V starts as b

The n-step returns in G^lambda need a bootstrap value after n steps, at the end of a roll-out, and at a time-out without
reward. The first form uses b, as the published code does: for lambda < 1, advantages are then sums of r + gamma b(s') -
b(s), so b guides the policy. The second uses the on-policy value: b then shifts advantages by a function of the state
only, which leaves the mean of the gradient unchanged. The third is guided by b at first and by the learnt value in the
end. Both algorithms standardise advantages.
"""

from __future__ import annotations

import warnings
from typing import Any, Protocol

import numpy as np
import torch
from ctrl_rl_learning.sb3 import REWARD_SCALE, observation_scales
from numpy.typing import NDArray
from sb3_contrib import TRPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.policies import ActorCriticPolicy

from ctrl_rl_core import NavigationTask
from oc_baseline_node.errors import OcError
from oc_baseline_node.values.mlp_value import MlpValue

Observations = NDArray[np.float32]
Values = NDArray[np.float32]


class Baseline(Protocol):
    """Any function of the observation alone, which leaves the gradient of Eq. 3.14 unbiased."""

    def __call__(self, observations: Observations) -> Values:
        """Return b (N,), in units of the learner's reward, for observations (N, d)."""


class OcBaseline:
    """V_oc of the state contained in an observation (x_k of s_k), in units of the learner's reward.

    Args:
        value: Optimal control value V_oc of the task, over the task's states.
        task: Task of the observations, scaled as in `ctrl_rl_learning.sb3.environment`.
        noise: Standard deviation of noise on each component of x_k before V_oc is evaluated, in SI units
            (thesis Fig. 3.16); drawn from torch's generator, which a run seeds.

    Raises:
        OcError: The value has other states than the task.
    """

    def __init__(self, value: MlpValue, task: NavigationTask, noise: float = 0.0) -> None:
        if value.state_names != task.system.build().state_names:
            raise OcError(f"V_oc of task '{value.task}' has other states than task '{task.name}': fit it for this task")
        offset, scale = observation_scales(task)
        # A policy acts only during the episode, but the collision set of V_oc, a disc, is larger than the body, so its
        # collision reward would apply too early.
        value = value.without_collisions()
        self._value, self._count, self._noise = value, len(value.state_names), noise
        self._offset, self._scale = offset[: self._count], scale[: self._count]

    def states(self, observations: Observations) -> NDArray[np.float64]:
        """Return the states (N, n) [SI units] contained in observations (N, d)."""
        return observations[:, : self._count].astype(np.float64) * self._scale + self._offset

    def __call__(self, observations: Observations) -> Values:
        """Return b (N,) for observations (N, d)."""
        states = self.states(observations)
        if self._noise > 0.0:
            states += self._noise * torch.randn(states.shape, dtype=torch.float64).numpy()
        return (REWARD_SCALE * self._value.value(self._value.clipped(states))).astype(np.float32)


PERCENTILES = (5, 50, 95)
"""Percentiles of a roll-out's advantages, recorded for thesis Fig. 3.12."""


class BaselineBuffer(RolloutBuffer):
    """Roll-out buffer with the advantages G^lambda - b(s) (Eq. 3.14).

    Args:
        baseline: Baseline b; None to use the policy's value, the learnt V or a `BaselinePolicy`'s own.

    Attributes:
        ranges: `PERCENTILES` of the advantages of each roll-out since the last `take_ranges`, before standardisation.
    """

    def __init__(self, *arguments: Any, baseline: Baseline | None = None, **others: Any) -> None:
        self.baseline = baseline
        self.ranges: list[list[float]] = []
        super().__init__(*arguments, **others)

    def compute_returns_and_advantage(self, last_values: torch.Tensor, dones: NDArray[Any]) -> None:
        """Compute G^lambda (`returns`) as Stable-Baselines3 does, then the advantages."""
        super().compute_returns_and_advantage(last_values, dones)
        if self.baseline is not None:
            flat = self.observations.reshape(-1, *self.obs_shape)
            self.advantages = self.returns - self.baseline(flat).reshape(self.returns.shape)
        self.ranges.append([float(x) for x in np.percentile(self.advantages, PERCENTILES)])

    def take_ranges(self) -> list[list[float]]:
        """Return `ranges` and clear them."""
        ranges, self.ranges = self.ranges, []
        return ranges


class BaselinePolicy(ActorCriticPolicy):
    """A policy whose value is a fixed function, used as baseline and to bootstrap G^lambda.

    Args:
        baseline: Baseline function b of the observations.
    """

    def __init__(self, *arguments: Any, baseline: Baseline, **others: Any) -> None:
        self.baseline = baseline
        super().__init__(*arguments, **others)

    def forward(
        self, obs: torch.Tensor, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return actions (N, m), the value (N, 1) and log-probabilities (N,)."""
        actions, learnt, log_probabilities = super().forward(obs, deterministic)
        return actions, self._value(obs, learnt), log_probabilities

    def predict_values(self, obs: Any) -> torch.Tensor:
        """Return the value (N, 1)."""
        return self._value(obs, super().predict_values(obs))

    def _value(self, observations: Any, learnt: torch.Tensor) -> torch.Tensor:  # noqa: ARG002 - for those who correct
        """Return the value (N, 1), given the network's output `learnt` (N, 1)."""
        return torch.from_numpy(self.baseline(observations.numpy()))[:, None]


class CorrectedPolicy(BaselinePolicy):
    """A policy whose value is a given function plus a learnt correction, initially 0: V(s) = b(s) + V_theta(s).

    Initially b guides the policy, like the reward r + gamma b(s') - b(s) (potential-based shaping: Ng, Harada and
    Russell 1999; equivalent to an initial value b: Wiewiora 2003); V then converges to the value of the policy.

    Args:
        baseline: Baseline function b of the observations.
    """

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        torch.nn.init.zeros_(self.value_net.weight)
        torch.nn.init.zeros_(self.value_net.bias)

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Return the value (N, 1), log-probabilities of actions (N,) and entropy (N,)."""
        learnt, log_probabilities, entropy = super().evaluate_actions(obs, actions)
        return self._value(obs, learnt), log_probabilities, entropy

    def _value(self, observations: Any, learnt: torch.Tensor) -> torch.Tensor:
        return super()._value(observations, learnt) + learnt


class FrozenValueTrpo(TRPO):
    """TRPO without value learning, for a `BaselinePolicy` with `n_critic_updates=0`."""

    def train(self) -> None:
        """Train on the roll-out, without the library's warning about a missing value loss."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            super().train()

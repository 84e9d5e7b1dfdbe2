"""PPO, TRPO, DDPG and SAC of Stable-Baselines3, each with one set of hyperparameters for all rewards and tasks.

Every hidden layer is normalised, as in the published code for DDPG; this halves the samples that each algorithm needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from sb3_contrib import TRPO
from stable_baselines3 import DDPG, PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from ctrl_rl_core import Actor, NavigationTask
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.sb3.algorithm_names import ALGORITHMS
from ctrl_rl_learning.sb3.environment import observation_scales
from ctrl_rl_learning.torch.networks import linear_arrays

REWARD_SCALE = 0.01
"""Factor that multiplies every reward before learning, so that values are of the order of 1 to 10."""
ROLL_OUT = 2048
"""Samples between two updates of PPO; TRPO updates twice as often."""

_GAMMA = 0.98
_HIDDEN = (64, 64)
_NOISE, _RETURN = 0.5, 0.3
"""Parameters of the Ornstein-Uhlenbeck noise, per step, with a correlation time of a few steps. (With the library's
hundreds of steps an episode starts without noise; independent noise keeps the robot near its start.)"""
_ON_POLICY_ENVIRONMENTS = 8
_OFF_POLICY = ("ddpg", "sac")


class NormalizedTanh(torch.nn.Module):
    """Layer normalisation followed by tanh."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the outputs (N, units)."""
        return torch.tanh(torch.nn.functional.layer_norm(x, x.shape[-1:]))


class NormalizedRelu(torch.nn.Module):
    """Layer normalisation followed by ReLU."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the outputs (N, units)."""
        return torch.relu(torch.nn.functional.layer_norm(x, x.shape[-1:]))


def number_of_environments(algorithm: str) -> int:
    """Return the number of parallel environments of an algorithm.

    Raises:
        LearningError: there is no such algorithm.
    """
    if algorithm not in ALGORITHMS:
        raise LearningError(f"no algorithm '{algorithm}': there are {', '.join(ALGORITHMS)}")
    return 1 if algorithm in _OFF_POLICY else _ON_POLICY_ENVIRONMENTS


def make_algorithm(
    algorithm: str,
    make: Callable[[], gymnasium.Env[Any, Any]] | VecEnv,
    seed: int,
    samples: int,
    kind: type[BaseAlgorithm] | None = None,
    **changes: Any,
) -> BaseAlgorithm:
    """Return an untrained algorithm with its own environments.

    Args:
        algorithm: One of `ALGORITHMS`.
        make: Returns a new environment; or a vectorised one of `number_of_environments` with scaled rewards.
        seed: Seed of networks, actions and environments.
        samples: Maximum number of samples that the algorithm sees.
        kind: Subclass of the algorithm to create instead.
        changes: Other arguments of Stable-Baselines3, e.g. `gamma`; `policy_kwargs` extends the defaults.

    Raises:
        LearningError: there is no such algorithm.
    """
    if isinstance(make, VecEnv):
        environments = make
    else:
        environments = DummyVecEnv([lambda: scaled_reward(make())] * number_of_environments(algorithm))
    numbers = _NUMBERS[algorithm](samples)
    numbers["policy_kwargs"] |= changes.pop("policy_kwargs", {})
    policy = changes.pop("policy", "MlpPolicy")
    own: Any = kind or {"ppo": PPO, "trpo": TRPO, "ddpg": DDPG, "sac": SAC}[algorithm]
    made: BaseAlgorithm = own(policy, environments, seed=seed, device="cpu", **{**numbers, **changes})
    return made


def _ppo(_: int) -> dict[str, Any]:
    return {
        "gamma": _GAMMA,
        "learning_rate": 1e-3,
        "n_steps": ROLL_OUT // _ON_POLICY_ENVIRONMENTS,
        "batch_size": 256,
        "policy_kwargs": {**_network(), "activation_fn": NormalizedTanh, "log_std_init": -0.5},
    }


def _trpo(_: int) -> dict[str, Any]:
    return {
        "gamma": _GAMMA,
        "n_steps": ROLL_OUT // _ON_POLICY_ENVIRONMENTS // 2,
        "batch_size": 64,
        "target_kl": 0.02,
        "n_critic_updates": 20,
        "policy_kwargs": {**_network(), "activation_fn": NormalizedTanh, "log_std_init": -0.5},
    }


def _ddpg(samples: int) -> dict[str, Any]:
    noise = OrnsteinUhlenbeckActionNoise(np.zeros(2), np.full(2, _NOISE), theta=_RETURN, dt=1.0)
    return {**_off_policy(samples), "action_noise": noise}


def _sac(samples: int) -> dict[str, Any]:
    return {**_off_policy(samples), "ent_coef": "auto_0.1"}


def _off_policy(samples: int) -> dict[str, Any]:
    return {
        "gamma": _GAMMA,
        "learning_rate": 1e-3,
        "buffer_size": samples,
        "learning_starts": min(2000, samples // 4),
        "batch_size": 128,
        "tau": 0.02,
        "n_steps": 5,
        "train_freq": (8, "step"),
        "gradient_steps": 4,
        "policy_kwargs": {**_network(), "activation_fn": NormalizedRelu},
    }


def _network() -> dict[str, Any]:
    return {"net_arch": list(_HIDDEN), "optimizer_kwargs": {"fused": True}}


_NUMBERS = {"ppo": _ppo, "trpo": _trpo, "ddpg": _ddpg, "sac": _sac}


def scaled_reward(environment: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """Return the environment with its rewards multiplied by `REWARD_SCALE`."""
    return gymnasium.wrappers.TransformReward(environment, lambda reward: REWARD_SCALE * float(reward))


def extract_actor(model: BaseAlgorithm, task: NavigationTask, manifest: Mapping[str, Any]) -> Actor:
    """Return the current deterministic policy of an algorithm."""
    on_policy = not isinstance(model, OffPolicyAlgorithm)
    policy: Any = model.policy
    if on_policy:
        layers = [*policy.mlp_extractor.policy_net, policy.action_net]
    elif isinstance(model, SAC):
        layers = [*policy.actor.latent_pi, policy.actor.mu]
    else:
        layers = list(policy.actor.mu)
    weights, biases = linear_arrays(layers)
    middle, unit = observation_scales(task)
    commands = np.array(list(task.robot.commands.values()), dtype=np.float32)
    return Actor(
        weights=weights,
        biases=biases,
        activation="normalized_tanh" if on_policy else "normalized_relu",
        squashed=not on_policy,
        middle=middle,
        unit=unit,
        low=commands[:, 0],
        high=commands[:, 1],
        manifest=manifest,
    )

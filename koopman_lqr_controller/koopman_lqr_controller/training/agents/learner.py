"""Learners with a replay: that of thesis Algorithm 2, and its base class."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping

import numpy as np
import torch
from ctrl_rl_learning.torch import Arrays, restore_state, state_arrays
from numpy.typing import NDArray
from torch import nn

from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.training.agents.actor import AgentInterface
from koopman_lqr_controller.training.agents.agent import Agent
from koopman_lqr_controller.training.agents.model_based_agent import ModelBasedAgent
from koopman_lqr_controller.training.agents.network_policy import NetworkPolicy
from koopman_lqr_controller.training.agents.soft_agent import SoftAgent
from koopman_lqr_controller.training.environments.task import AnyEnvironment, BenchmarkTask
from koopman_lqr_controller.training.replay import Mirror, Replay

_UPDATES = "updates"
_ENCODERS = {
    "contrastive": " with contrastive encoder (thesis 4.2)",
    "reconstruction": " with an autoencoder (thesis 4.3.5)",
    "reconstruction_prediction": " with an autoencoder that predicts (thesis 4.3.5)",
    "nothing": "",
}
Act = Callable[[NDArray[np.generic]], NDArray[np.float32]]

_UNREWARDED = 10
"""Factor of the number of random actions while every reward has been zero."""


class ReplayLearner(ABC):
    """A learner that stores its steps in a replay, and learns one chunk of a run at a time.

    Args:
        problem: Task to learn.
        environment: Environment to act in.
        seed: Random seed.

    Attributes:
        interface: Observations and controls of the agent.
        replay: Stored steps.
    """

    replay: Replay

    def __init__(self, problem: BenchmarkTask, environment: AnyEnvironment, seed: int) -> None:
        self._settings, self._environment, self._seed = problem.settings, environment, seed
        self.interface = AgentInterface(
            shape=environment.observation_space.shape,
            controls=environment.action_space.shape[0],
            middle=np.array(problem.middle, np.float32),
            unit=np.array(problem.unit, np.float32),
            goal=None if problem.goal is None else np.array(problem.goal, np.float32),
            kind=environment.observation_space.dtype.type,
        )
        self._modules: Mapping[str, nn.Module] = {}
        self._optimizers: Mapping[str, torch.optim.Optimizer] = {}

    @abstractmethod
    def _begin(self, random: np.random.Generator) -> tuple[Act | None, Callable[[], None]]:
        """Return the behaviour policy of a chunk, None for random actions, and the agent to update."""

    def take_losses(self) -> dict[str, float]:
        """Return the mean losses since the last call, by name."""
        return {}

    def _meet(self, x: NDArray[np.generic]) -> None:  # noqa: B027 - most learners need none
        """Record an observation."""

    def learn(self, chunk: int, done: int, actions: int, episodes: int) -> tuple[int, int]:
        """Act, starting with a new episode, and learn for one chunk.

        Args:
            chunk: Index of the chunk, which together with the seed determines all random numbers.
            done: Number of actions before the chunk.
            actions: Number of actions; the last one ends its episode.
            episodes: Number of episodes after which the chunk ends; 0 for no limit.

        Returns:
            Numbers of actions executed and of episodes started.
        """
        settings, environment, random = self._settings, self._environment, np.random.default_rng((self._seed, chunk))
        act, update = self._begin(random)
        begun, rewarded = 0, bool(self.replay.everything().reward.any())
        x, _ = environment.reset(seed=int(random.integers(2**31)))
        for step in range(1, actions + 1):
            # A learner that has seen no reward learns to stand still, and explores less than random actions do.
            learning = done + step > settings.first_steps * (1 if rewarded else _UNREWARDED)
            if act is not None and learning:
                u = act(x)
            else:
                u = random.uniform(-1.0, 1.0, environment.action_space.shape).astype(np.float32)
            x_next, reward, terminated, truncated, _ = environment.step(u)
            self._meet(x)
            self.replay.add(x, u, float(reward), bool(terminated))
            rewarded = rewarded or reward != 0.0
            x = x_next
            ended = terminated or truncated or step == actions
            if ended:
                self.replay.end_episode(x_next)
                begun += 1
                x, _ = environment.reset(seed=int(random.integers(2**31)))
            if learning and (done + step) % settings.update_every == 0:
                update()
            if ended and begun == episodes:
                return step, begun
        return actions, begun

    def arrays(self) -> Arrays:
        """Return networks, optimisers and replay."""
        return {**state_arrays(self._modules, self._optimizers), **self.replay.arrays()}

    def restore(self, arrays: Arrays, /) -> None:
        """Restore the state returned by `arrays`."""
        restore_state(self._modules, self._optimizers, arrays)
        self.replay.restore(arrays)


class KoopmanLearner(ReplayLearner):
    """An agent with replay and environment; with suitable settings, the learner of Algorithm 2.

    Args:
        problem: Task to learn.
        environment: Environment to act in.
        seed: Random seed.
        capacity: Maximum number of observations in the replay.
        device: Device of the networks.
    """

    def __init__(
        self, problem: BenchmarkTask, environment: AnyEnvironment, seed: int, capacity: int, device: str = "cpu"
    ) -> None:
        super().__init__(problem, environment, seed)
        self._mirror: Mirror | None = getattr(environment, "mirror", None)
        model_based = problem.settings.critic == "model_based"
        self._agent: Agent = (ModelBasedAgent if model_based else SoftAgent)(
            self.interface, problem.settings, seed, device
        )
        how = " with values after MR.Q" if model_based else _ENCODERS[problem.settings.encoder_loss]
        self.method = "task-oriented Koopman control" + how
        self.replay = self._agent.make_replay(self.interface, min(problem.settings.replay, capacity))
        self._modules, self._optimizers = {"agent": self._agent}, self._agent.optimizers

    def _meet(self, x: NDArray[np.generic]) -> None:
        self._agent.meet(x)

    def _begin(self, random: np.random.Generator) -> tuple[Act, Callable[[], None]]:
        generator = torch.Generator().manual_seed(int(random.integers(2**63)))

        def update() -> None:
            for _ in range(self._settings.updates):
                self._agent.learn(self.replay, random, generator, self._mirror)

        return lambda x: self._agent.act(x, generator), update

    def take_losses(self) -> dict[str, float]:
        """Return the mean losses since the last call, by name, and the policy's entropy if it has one."""
        return self._agent.take_losses()

    def candidates(self) -> dict[str, LatentController | NetworkPolicy]:
        """Return the averaged actor and the current actor."""
        return {"averaged": self._agent.averaged.deploy(), "actor": self._agent.actor.deploy()}

    def arrays(self) -> Arrays:
        """Return networks, optimisers, replay and the number of updates."""
        return {**super().arrays(), _UPDATES: np.array(self._agent.updates)}

    def restore(self, arrays: Arrays, /) -> None:
        """Restore the state returned by `arrays`."""
        super().restore(arrays)
        self._agent.updates = int(arrays[_UPDATES].item())

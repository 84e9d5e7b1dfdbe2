"""Stable-Baselines3's soft actor-critic on the same tasks, as a model-free baseline."""

from __future__ import annotations

import numpy as np
from ctrl_rl_learning.sb3 import entropy_of, listen, model_arrays, restore_model
from ctrl_rl_learning.torch import Arrays
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.encoder import Encoder
from koopman_lqr_controller.training.agents.network_policy import NetworkPolicy
from koopman_lqr_controller.training.environments.task import AnyEnvironment, BenchmarkTask
from koopman_lqr_controller.training.networks.networks import deploy_layers

_SAMPLES = "samples"
_NOUGHT, _ONE = np.zeros((), np.float32), np.ones((), np.float32)


class SacLearner:
    """SAC with the task's hyperparameters where the library has them; the replay stores all actions of a run.

    Raises:
        KoopmanError: The task has image observations.
    """

    method = "soft actor-critic (Stable-Baselines3)"
    replay = None

    def __init__(
        self, problem: BenchmarkTask, environment: AnyEnvironment, seed: int, capacity: int, device: str = "cpu"
    ) -> None:
        settings = problem.settings
        if settings.crop:
            raise KoopmanError(f"{problem.name}: sac learns from vectors only; `--set policy=network` sees pictures")
        self._seed = seed
        self._model = SAC(
            "MlpPolicy",
            environment,
            learning_rate=settings.learning_rate,
            buffer_size=capacity,
            learning_starts=settings.first_steps,
            batch_size=settings.batch,
            tau=settings.critic_rate,
            gamma=settings.discount,
            train_freq=settings.update_every,
            ent_coef=f"auto_{settings.temperature}",
            policy_kwargs={"net_arch": [settings.hidden, settings.hidden]},
            seed=seed,
            device=device,
        )
        self._logger = listen(self._model)

    def learn(self, chunk: int, done: int, actions: int, episodes: int) -> tuple[int, int]:  # noqa: ARG002 - it counts
        """Act and learn for one chunk; return the numbers of actions executed and episodes started."""
        model = self._model
        model.set_random_seed(int(np.random.SeedSequence((self._seed, chunk)).generate_state(1)[0]) % 2**31)
        model._last_obs = None  # makes `learn` start a new episode
        counter, before = _Counter(episodes), model.num_timesteps
        model.learn(actions, callback=counter, reset_num_timesteps=False)
        return model.num_timesteps - before, counter.begun

    def take_losses(self) -> dict[str, float]:
        """Return the mean losses since the last call, by name, and the policy's entropy."""
        return self._logger.take() | entropy_of(self._model)

    def candidates(self) -> dict[str, NetworkPolicy]:
        """Return the current actor."""
        actor = self._model.actor
        layers = deploy_layers(nn.Sequential(*actor.latent_pi, actor.mu))
        shape = self._model.observation_space.shape
        assert shape is not None
        return {"actor": NetworkPolicy(Encoder(tuple(layers), shape, _NOUGHT, _ONE))}

    def arrays(self) -> Arrays:
        """Return networks, optimisers and replay."""
        return {**model_arrays(self._model), _SAMPLES: np.array([self._model.num_timesteps])}

    def restore(self, arrays: Arrays, /) -> None:
        """Restore the state returned by `arrays`."""
        restore_model(self._model, arrays)
        self._model.num_timesteps = int(arrays[_SAMPLES].item())


class _Counter(BaseCallback):
    """Counts episodes, and ends learning after a given number.

    Args:
        episodes: Maximum number of episodes; 0 for no limit.

    Attributes:
        begun: Number of episodes, including the current one.
    """

    def __init__(self, episodes: int) -> None:
        super().__init__()
        self.begun, self._episodes, self._under_way = 0, episodes, False

    def _on_step(self) -> bool:
        if not self._under_way:
            self.begun += 1
        self._under_way = not self.locals["dones"][0]
        return self._under_way or self.begun != self._episodes

"""Algorithm 2 of the thesis: act, remember, update; what the chunks of a run are made of."""

from __future__ import annotations

import numpy as np
import torch
from ctrl_rl_training.learner_state import Arrays, restore_state, state_arrays

from koopman_lqr_controller.latent_controller import LatentController
from koopman_lqr_controller.training.agent import Agent, Sight
from koopman_lqr_controller.training.problems import AnyEnvironment, Problem
from koopman_lqr_controller.training.replay import Replay

_REPLAY = "replay."
_UPDATES = "updates"


class KoopmanLearner:
    """An agent, what it has lived through, and where it acts.

    Args:
        problem: that it learns.
        environment: to act in.
        seed: of everything random.
        capacity: places of the replay, at most those of the settings.
        device: of the networks.
    """

    method = "task-oriented Koopman control with contrastive encoder (thesis 4.2)"

    def __init__(
        self, problem: Problem, environment: AnyEnvironment, seed: int, capacity: int, device: str = "cpu"
    ) -> None:
        self._settings, self._environment, self._seed = problem.settings, environment, seed
        seen = environment.observation_space
        sight = Sight(
            shape=seen.shape,
            controls=environment.action_space.shape[0],
            middle=np.array(problem.middle, np.float32),
            unit=np.array(problem.unit, np.float32),
            goal=None if problem.goal is None else np.array(problem.goal, np.float32),
        )
        self._agent = Agent(sight, problem.settings, seed, device)
        self._replay = Replay(min(problem.settings.replay, capacity), sight.shape, sight.controls, seen.dtype.type)

    def learn(self, chunk: int, done: int, actions: int, episodes: int) -> tuple[int, int]:
        """Act and learn; see `course.Learner`."""
        settings, environment, agent = self._settings, self._environment, self._agent
        random = np.random.default_rng((self._seed, chunk))
        generator = torch.Generator().manual_seed(int(random.integers(2**63)))
        shape, begun = environment.action_space.shape, 0
        x, _ = environment.reset(seed=int(random.integers(2**31)))
        for step in range(1, actions + 1):
            learning = done + step > settings.first_steps
            u = agent.act(x, generator) if learning else random.uniform(-1.0, 1.0, shape).astype(np.float32)
            x_next, reward, terminated, truncated, _ = environment.step(u)
            self._replay.add(x, u, float(reward), bool(terminated))
            x = x_next
            ended = terminated or truncated or step == actions
            if ended:
                self._replay.end_episode(x_next)
                begun += 1
                x, _ = environment.reset(seed=int(random.integers(2**31)))
            if learning and (done + step) % settings.update_every == 0:
                agent.update(self._replay.draw(settings.batch, random), generator)
            if ended and begun == episodes:
                return step, begun
        return actions, begun

    def candidates(self) -> dict[str, LatentController]:
        """Return the average of the actor, and the actor as it is now."""
        return {"averaged": self._agent.averaged.deploy(), "actor": self._agent.actor.deploy()}

    def arrays(self) -> Arrays:
        """Return networks, optimisers and replay."""
        out = state_arrays({"agent": self._agent}, self._agent.optimizers)
        out |= {f"{_REPLAY}{name}": array for name, array in self._replay.arrays().items()}
        return {**out, _UPDATES: np.array(self._agent.updates)}

    def restore(self, arrays: Arrays, /) -> None:
        """Take what `arrays` gave."""
        restore_state({"agent": self._agent}, self._agent.optimizers, arrays)
        replay = {name.removeprefix(_REPLAY): array for name, array in arrays.items() if name.startswith(_REPLAY)}
        self._replay.restore(replay)
        self._agent.updates = int(arrays[_UPDATES].item())

"""The learner of thesis Algorithm 2: it acts, remembers and updates, one chunk of a run at a time."""

from __future__ import annotations

import numpy as np
import torch
from ctrl_rl_training.io.learner_state import Arrays, restore_state, state_arrays
from numpy.typing import NDArray

from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.training.agents.actor import AgentInterface
from koopman_lqr_controller.training.agents.agent import Agent
from koopman_lqr_controller.training.agents.interaction import collect_transitions
from koopman_lqr_controller.training.agents.network_policy import NetworkPolicy
from koopman_lqr_controller.training.environments.benchmark_tasks import AnyEnvironment, BenchmarkTask
from koopman_lqr_controller.training.replay import Mirror, Replay

_UPDATES = "updates"


class KoopmanLearner:
    """An agent, what it has met, and where it acts.

    Args:
        problem: Task to learn.
        environment: To act in.
        seed: Seed of all random numbers.
        capacity: Places of the replay, at most those of the settings.
        device: Device of the networks: "cpu" or "cuda".
    """

    method = "task-oriented Koopman control with contrastive encoder (thesis 4.2)"

    def __init__(
        self, problem: BenchmarkTask, environment: AnyEnvironment, seed: int, capacity: int, device: str = "cpu"
    ) -> None:
        self._settings, self._environment, self._seed = problem.settings, environment, seed
        self._mirror: Mirror | None = getattr(environment, "mirror", None)
        interface = agent_interface(problem, environment)
        self._agent = Agent(interface, problem.settings, seed, device)
        kind = environment.observation_space.dtype.type
        self.replay = Replay(min(problem.settings.replay, capacity), interface.shape, interface.controls, kind)

    def learn(self, chunk: int, done: int, actions: int, episodes: int) -> tuple[int, int]:
        """Act and learn for one chunk, as `trainer.Learner` says."""
        settings, agent, shape = self._settings, self._agent, self._environment.action_space.shape
        random = np.random.default_rng((self._seed, chunk))
        generator = torch.Generator().manual_seed(int(random.integers(2**63)))

        def act(step: int, x: NDArray[np.generic]) -> NDArray[np.float32]:
            learning = done + step > settings.first_steps
            return agent.act(x, generator) if learning else random.uniform(-1.0, 1.0, shape).astype(np.float32)

        def update(step: int) -> None:
            if done + step <= settings.first_steps or (done + step) % settings.update_every:
                return
            for _ in range(settings.updates):
                steps = self.replay.draw(settings.batch, random)
                agent.update(steps if self._mirror is None else self._mirror.mirror_at_random(steps, random), generator)

        return collect_transitions(self._environment, self.replay, random, actions, episodes, act, update)

    def candidates(self) -> dict[str, LatentController | NetworkPolicy]:
        """Return the average of the actor, and the actor as it is now."""
        return {"averaged": self._agent.averaged.deploy(), "actor": self._agent.actor.deploy()}

    def arrays(self) -> Arrays:
        """Return networks, optimisers and replay."""
        out = state_arrays({"agent": self._agent}, self._agent.optimizers)
        return {**out, **self.replay.arrays(), _UPDATES: np.array(self._agent.updates)}

    def restore(self, arrays: Arrays, /) -> None:
        """Restore the state that `arrays` returned."""
        restore_state({"agent": self._agent}, self._agent.optimizers, arrays)
        self.replay.restore(arrays)
        self._agent.updates = int(arrays[_UPDATES].item())


def agent_interface(problem: BenchmarkTask, environment: AnyEnvironment) -> AgentInterface:
    """Return what an agent observes and controls in a task's environment."""
    return AgentInterface(
        shape=environment.observation_space.shape,
        controls=environment.action_space.shape[0],
        middle=np.array(problem.middle, np.float32),
        unit=np.array(problem.unit, np.float32),
        goal=None if problem.goal is None else np.array(problem.goal, np.float32),
    )

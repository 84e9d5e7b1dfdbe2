"""The environment named in a policy's manifest, and episodes of the policy in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import FunctionDriver, drive, load_navigation_task, task_digest
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.policies.edmd_policy import EdmdPolicy
from koopman_lqr_controller.policies.koopman_policy import ClosedLoopModel
from koopman_lqr_controller.policies.latent_policy import RobotInterface
from koopman_lqr_controller.policies.policy_file import KoopmanPolicy
from koopman_lqr_controller.training.environments.benchmark_tasks import task_of_manifest
from koopman_lqr_controller.training.environments.corridor import Conditions, Corridor, Vector
from koopman_lqr_controller.training.environments.task import AnyEnvironment

_CORRIDOR = "curved_corridor"


@dataclass(frozen=True)
class EpisodeTrajectory:
    """Observations, controls and rewards of one episode.

    Attributes:
        x: Observations (T + 1, *shape).
        u: The model's controls (T, m).
        rewards: (T,); empty without a reward.
        info: The environment's last word.
    """

    x: NDArray[Any]
    u: Array
    rewards: Array
    info: Mapping[str, Any]


class LiftedCorridor(Corridor):
    """The corridor as observed by a two-stage policy: observations are Psi, actions span the policy's own limits.

    Raises:
        KoopmanError: The task has changed since the policy was made.
    """

    def __init__(self, policy: EdmdPolicy, conditions: Conditions | None = None) -> None:
        known = task_digest(load_navigation_task(_CORRIDOR))
        if policy.manifest.get("task_digest", known) != known:
            raise KoopmanError(f"task {_CORRIDOR} has changed since the policy was made: train it again")
        self._policy = policy
        super().__init__(learning=False, conditions=conditions)
        self.robot_interface = RobotInterface(self.robot_interface.observation, policy.u_low, policy.u_high)

    def observe(self) -> Vector:
        """Return Psi of the current state, with new noise and drop-out in each call."""
        return self._policy.observables.observe(*self.scan(), *self.speeds()).astype(np.float32)


def make_world(policy: KoopmanPolicy, conditions: Conditions | None = None) -> AnyEnvironment:
    """Create the environment of a policy; if conditions are given, its corridor with such a robot.

    Raises:
        KoopmanError: The manifest names no existing environment, or the task has no corridor.
        ModuleNotFoundError: A simulator is not installed.
    """
    task = str(policy.manifest.get("task"))
    if isinstance(policy, EdmdPolicy):
        if task != _CORRIDOR:
            raise KoopmanError(f"there is no environment for the task {task}")
        return LiftedCorridor(policy, conditions)
    problem = task_of_manifest(policy.manifest)
    return problem.make(False) if conditions is None else Corridor(False, conditions, problem.task)


def run_episode(
    loop: ClosedLoopModel,
    environment: AnyEnvironment,
    seed: int,
    noise: float = 0.0,
    look: Callable[[], None] = lambda: None,
) -> EpisodeTrajectory:
    """Run one episode and return its trajectory.

    Args:
        loop: Closed loop of the policy.
        environment: Environment to act in.
        seed: Seed of the episode and of the noise.
        noise: Standard deviation of the noise added to the action in [-1, 1], to excite the model.
        look: Called in each state after the observation.
    """
    random, half = np.random.default_rng(seed), 0.5 * (loop.high - loop.low)
    controls: list[Array] = []

    def act(x: NDArray[Any]) -> NDArray[np.float32]:
        u = loop.control(loop.latent(x))
        controls.append(np.clip(u + noise * half * random.standard_normal(u.shape), loop.low, loop.high))
        return loop.action(controls[-1]).astype(np.float32)

    (episode,) = drive(environment, FunctionDriver(act), seeds=(seed,), keep=True, watch=lambda _: look())
    seen, rewards = [step.sensors for step in episode.trace], [step.reward for step in episode.trace[1:]]
    return EpisodeTrajectory(np.array(seen), np.array(controls), np.array(rewards), episode.info)

"""The suite's worlds as Gymnasium environments, for training.

    import gymnasium, sim_bridge.environments
    environment = gymnasium.make("ctrl_rl/car_ttr-v0")
    environments = gymnasium.make_vec("ctrl_rl/car_ttr-v0", num_envs=16)   # a fleet, some thousand samples a second
    environments = gymnasium.make_vec("ctrl_rl/curved_corridor-v0", num_envs=4, vectorization_mode="sync")

Each environment owns a physics engine; close it when done. To skip the import of this module, use the name
"sim_bridge.environments:ctrl_rl/car_ttr-v0".
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome, load_navigation_task, load_task, task_names
from sim_bridge.errors import SimulationError
from sim_bridge.simulation.observation_bounds import observation_bounds
from sim_bridge.simulation.options import SimulationOptions, whole_steps
from sim_bridge.simulation.world import SimulatedWorld

_LARGEST_SEED = 2**32

Vector = NDArray[np.float32]


class NavigationEnv(gymnasium.Env[Vector, Vector]):
    """One robot of a navigation task; episodes terminate at goal, collision or trap, and truncate at the step limit.

    Observation, in SI units and this order (`observation_names`): the system's state from odometry, angles in [-pi,
    pi]; in a corridor also speed v and turn rate omega; then the lidar's beams, at maximum range without an echo and at
    minimum range if too close. Action: [-1, 1] for each command of the task, mapped to its bounds. Reward: the task's
    rewards (thesis Eq. 3.9, 3.15, 3.17). Info: `outcome`, `state` (the true one), `clearance` [m] and, along a
    corridor, `progress` from 0 to 1.

    Attributes:
        task: Task of the environment.
        world: Its simulated world.
        observation_names: Names of the observation's components; beams are beam_0, beam_1, etc.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - gymnasium's own form

    def __init__(
        self,
        task: NavigationTask | str | Path,
        width: float | None = None,
        options: SimulationOptions | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Build the world.

        Args:
            task: A task, its name, or the path of its file.
            width: Free width of a corridor [m]; None for the task's width (or a random one, depending on `options`).
            options: Settings of the simulation.
            render_mode: Must be None; `options` can open PyBullet's window.

        Raises:
            SimulationError: The time step of the task is not a whole number of physics steps.
            TaskError: The task does not exist, or the width is invalid for it.
        """
        self.render_mode = render_mode
        self.task = task if isinstance(task, NavigationTask) else load_navigation_task(task)
        options = options or SimulationOptions()
        self._steps_per_action = whole_steps(self.task, options.rate)
        self._commands = np.array(list(self.task.robot.commands.values()))
        self.world = SimulatedWorld(self.task, width=width, options=options)
        self.observation_names, self._low, self._high = observation_bounds(self.task)
        self.observation_space = spaces.Box(self._low, self._high)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Vector, dict[str, Any]]:
        """Start an episode; the same seed gives the same start, noise and drift.

        Args:
            seed: Seed of the episode; random by default.
            options: `start` is the state (n,) to start in, in SI units; drawn from the task's start set by default.
        """
        super().reset(seed=seed, options=options)
        drawn = int(self.np_random.integers(_LARGEST_SEED)) if seed is None else seed
        self.world.reset(drawn, (options or {}).get("start"))
        return self._observation(), self._info()

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Hold an action (2,) for the task's time step."""
        self.world.command(0, self.command_of(action))
        self.world.step(self._steps_per_action)
        return self.result()

    def command_of(self, action: Vector) -> NDArray[np.float64]:
        """Convert an action (2,) to a command (2,) in SI units.

        Raises:
            SimulationError: The action is not two finite numbers.
        """
        values = np.asarray(action, dtype=float)
        if values.shape != (2,) or not np.isfinite(values).all():
            raise SimulationError(f"action {values.tolist()} is not two finite numbers")
        low, high = self._commands[:, 0], self._commands[:, 1]
        command: NDArray[np.float64] = low + 0.5 * (np.clip(values, -1.0, 1.0) + 1.0) * (high - low)
        return command

    def result(self) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Return the results of a step that ends now, for wrappers that step `world` themselves."""
        episode = self.world.episode(0)
        truncated = episode.outcome is Outcome.TIMEOUT
        terminated = episode.outcome is not Outcome.RUNNING and not truncated
        return self._observation(), episode.reward(self.task.rewards), terminated, truncated, self._info()

    def close(self) -> None:
        """Release the physics engine."""
        self.world.close()

    def _observation(self) -> Vector:
        world, reach = self.world, self.task.lidar.range
        parts = [world.measured_state(0)]
        if self.task.corridor is not None:
            forward, _, turn = world.odometry(0).velocity
            parts.append(np.array((forward, turn)))
        ranges = np.nan_to_num(world.scan(0), nan=reach.high, posinf=reach.high, neginf=reach.low)
        observation = np.concatenate((*parts, ranges)).astype(np.float32)
        return np.clip(observation, self._low, self._high)

    def _info(self) -> dict[str, Any]:
        episode = self.world.episode(0)
        info: dict[str, Any] = {
            "outcome": episode.outcome.name,
            "state": self.world.state(0),
            "clearance": episode.clearance,
        }
        if self.task.corridor is not None:
            info["progress"] = episode.progress
        return info


def register_environments() -> tuple[str, ...]:
    """Register each navigation task as ctrl_rl/NAME-v0 and return the environment ids."""
    tasks = {name: task for name in task_names() if isinstance(task := load_task(name), NavigationTask)}
    for name, task in tasks.items():
        alone = task.corridor or task.movers or task.randomisation  # a fleet's world stays as it is
        gymnasium.registry.pop(identifier := f"ctrl_rl/{name}-v0", None)
        gymnasium.register(
            identifier,
            "sim_bridge.environments:NavigationEnv",
            vector_entry_point=None if alone else "sim_bridge.fleet:NavigationVectorEnv",
            kwargs={"task": name},
        )
    return tuple(f"ctrl_rl/{name}-v0" for name in tasks)


register_environments()

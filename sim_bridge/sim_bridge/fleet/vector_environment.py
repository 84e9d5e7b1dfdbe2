"""A fleet of robots as a Gymnasium vector environment, for any learner.

environments = gymnasium.make_vec("sim_bridge.environments:ctrl_rl/car_ttr-v0", num_envs=16)
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome, load_navigation_task
from sim_bridge.fleet.planar_fleet import PlanarFleet
from sim_bridge.simulation.observation_bounds import observation_bounds

Vector = NDArray[np.float32]
_LARGEST_SEED = 2**32


class NavigationVectorEnv(VectorEnv[Vector, Vector, NDArray[Any]]):
    """A fleet of robots of one task, each in a world of its own, simulated at once in the planar engine.

    Observations (N, d), actions (N, 2) and rewards (N,) are those of `NavigationEnv`. An episode that ends begins
    anew in the same step; `info` then holds its last observation as `final_obs`, and its `outcome` and last `state` as
    `final_info`. `state` (N, n) in `info` are the true states.

    Args:
        task: A task, its name, or the path of its file.
        num_envs: Number of robots.

    Raises:
        SimulationError: The world of the task changes between episodes, or the task has a corridor.
        TaskError: The task does not exist.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 - gymnasium's own form

    def __init__(self, task: NavigationTask | str | Path, num_envs: int = 1) -> None:
        loaded = task if isinstance(task, NavigationTask) else load_navigation_task(task)
        self._fleet = PlanarFleet(loaded, num_envs)
        _, self._low, self._high = observation_bounds(loaded)
        self._random = [np.random.default_rng() for _ in range(num_envs)]
        self.num_envs = num_envs
        self.single_observation_space = spaces.Box(self._low, self._high)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Vector, dict[str, Any]]:
        """Begin an episode for each robot; robot i takes the seed plus i, or the i-th of a list.

        `options` may hold a `reset_mask` (N,) of the robots to begin.
        """
        seeds = (
            [None if seed is None else seed + i for i in range(self.num_envs)] if not isinstance(seed, list) else seed
        )
        self._random = [
            random if each is None else np.random.default_rng(each)
            for each, random in zip(seeds, self._random, strict=True)
        ]
        mask = (options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool))
        self._begin(np.asarray(mask, dtype=bool))
        return self._observe(), self._states()

    def step(self, actions: Vector) -> tuple[Vector, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Hold the actions (N, 2) for the task's time step."""
        outcomes = self._fleet.step(np.clip(np.asarray(actions, dtype=float), -1.0, 1.0)).copy()
        rewards, observed = self._fleet.rewards().copy(), self._observe()
        truncated = outcomes == Outcome.TIMEOUT
        over = outcomes != Outcome.RUNNING
        final: dict[str, Any] = {}
        if over.any():
            last, names = np.full(self.num_envs, None, dtype=object), np.full(self.num_envs, None, dtype=object)
            for robot in np.flatnonzero(over):
                last[robot], names[robot] = observed[robot], Outcome(outcomes[robot]).name
            final = {"final_obs": last, "_final_obs": over, "_final_info": over}
            final["final_info"] = {"outcome": names, "_outcome": over, **self._states()}
            self._begin(over)
            observed = self._observe()
        return observed, rewards, over & ~truncated, truncated, {**final, **self._states()}

    def _begin(self, which: NDArray[np.bool_]) -> None:
        for robot in np.flatnonzero(which):
            self._fleet.begin(int(robot), int(self._random[robot].integers(_LARGEST_SEED)), None)

    def _states(self) -> dict[str, Any]:
        return {"state": self._fleet.states().copy(), "_state": np.ones(self.num_envs, dtype=bool)}

    def _observe(self) -> Vector:
        return np.clip(self._fleet.observations().astype(np.float32), self._low, self._high)

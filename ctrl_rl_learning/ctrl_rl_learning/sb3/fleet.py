"""A fleet of robots as vectorised environments for Stable-Baselines3, and for evaluating policies.

`FleetReward` replaces the task's rewards, and `FleetStarts` its start states.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from ctrl_rl_core import Actor, Episodes, NavigationTask, Outcome, drive_fleet
from ctrl_rl_learning.sb3.algorithms import REWARD_SCALE
from ctrl_rl_learning.sb3.environment import Vector, observation_scales
from sim_bridge import PlanarFleet

Array = NDArray[np.float64]
_LARGEST_SEED = 2**32


class FleetReward(Protocol):
    """Reward function for the steps of all robots."""

    def begin(self, robots: Sequence[int], states: Array) -> None:
        """Begin episodes of the given robots at their states (len(robots), n)."""

    def pay(self, states: Array, outcomes: NDArray[np.intp], rewards: Array) -> Array:
        """Return the reward of a step for each robot (N,).

        Args:
            states: States after the step (N, n).
            outcomes: Outcomes of the robots' episodes, values of `Outcome` (N,).
            rewards: Rewards of the task (N,).
        """


class FleetStarts(Protocol):
    """Start states of training episodes."""

    def draw(self, robot: int, random: np.random.Generator) -> Array | None:
        """Return the start state (n,) of a robot's next episode; None to let the task draw it."""

    def ended(self, robot: int, outcome: Outcome) -> None:
        """Receive the outcome of a robot's episode."""


class FleetEnvironments(VecEnv):
    """Vectorised environments of a fleet, which restart finished episodes and scale as `ScaledObservation` does.

    Args:
        task: Task of the robots.
        size: Number of robots.
        reward: Reward of the steps; the task's own by default.
        starts: Start states of episodes; the task's start set by default.
        timeout_ends: Whether a time-out ends the return, as a collision does, instead of bootstrapping from the value
            of the last state; for tasks whose reward for a time-out the learner should see.
    """

    def __init__(
        self,
        task: NavigationTask,
        size: int,
        reward: FleetReward | None = None,
        starts: FleetStarts | None = None,
        timeout_ends: bool = False,
    ) -> None:
        self._truncating = None if timeout_ends else Outcome.TIMEOUT
        self.render_mode = None
        self._fleet, self._reward, self._starts = PlanarFleet(task, size), reward, starts
        self._middle, self._unit = observation_scales(task)
        self._actions = np.zeros((size, 2))
        self._random = [np.random.default_rng(robot) for robot in range(size)]
        observed = spaces.Box(-np.inf, np.inf, self._middle.shape, np.float32)
        super().__init__(size, observed, spaces.Box(-1.0, 1.0, (2,), np.float32))

    def reset(self) -> Vector:
        """Begin an episode for each robot; return the observations (N, d)."""
        for robot, seed in enumerate(self._seeds):
            if seed is not None:
                self._random[robot] = np.random.default_rng(seed)
        self._reset_seeds()
        self._begin(range(self.num_envs))
        return self._observe()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions (N, 2) in [-1, 1] for the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[Vector, Vector, NDArray[np.bool_], list[dict[str, Any]]]:
        """Apply the stored actions for one time step of the task."""
        outcomes = self._fleet.step(self._actions).copy()
        states, paid, observed = self._fleet.states(), self._fleet.rewards(), self._observe()
        if self._reward is not None:
            paid = self._reward.pay(states, outcomes, paid)
        infos: list[dict[str, Any]] = [
            {"outcome": Outcome(outcome).name, "state": state, "TimeLimit.truncated": outcome == self._truncating}
            for outcome, state in zip(outcomes, states, strict=True)
        ]
        over = outcomes != Outcome.RUNNING
        if over.any():
            ended = np.flatnonzero(over).tolist()
            for robot in ended:
                infos[robot]["terminal_observation"] = observed[robot]
                if self._starts is not None:
                    self._starts.ended(robot, Outcome(outcomes[robot]))
            self._begin(ended)
            fresh = self._observe()
            observed = np.where(over[:, None], fresh, observed)
        return observed, (REWARD_SCALE * paid).astype(np.float32), over, infos

    def states(self) -> Array:
        """Return the true states (N, n)."""
        return self._fleet.states()

    def _begin(self, robots: Sequence[int]) -> None:
        for robot in robots:
            random = self._random[robot]
            start = None if self._starts is None else self._starts.draw(robot, random)
            self._fleet.begin(robot, int(random.integers(_LARGEST_SEED)), start)
        if self._reward is not None:
            self._reward.begin(robots, self._fleet.states()[list(robots)])

    def _observe(self) -> Vector:
        return ((self._fleet.observations() - self._middle) / self._unit).astype(np.float32)

    def close(self) -> None:
        """Do nothing: the fleet holds no resources."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, which is the same for all robots."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, *_: Any) -> None:
        """Raise an error: robots have no attributes of their own."""
        raise AttributeError(f"a fleet's robots have no '{attr_name}' of their own")

    def env_method(self, method_name: str, *_: Any, **__: Any) -> list[Any]:
        """Raise an error: robots have no methods of their own."""
        raise AttributeError(f"a fleet's robots have no '{method_name}' of their own")

    def env_is_wrapped(self, _: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Any = None) -> list[bool]:
        """Return False for each robot: none is wrapped."""
        return [False] * len(list(self._get_indices(indices)))


def fits_fleet(task: NavigationTask) -> bool:
    """Return whether a fleet can simulate a task: no corridor, moving obstacles, randomisation or steered wheels."""
    robot = task.robot.robot
    steered = robot is not None and robot.steering is not None
    return not (task.corridor or task.movers or task.randomisation or steered)


class _ScaledFleet:
    """Fleet for `drive_fleet` with observations scaled as for learners."""

    def __init__(self, task: NavigationTask, reward: FleetReward | None) -> None:
        self._task, self._reward = task, reward
        self._middle, self._unit = observation_scales(task)

    def begin(self, seeds: Sequence[int]) -> tuple[NDArray[np.floating], Array]:
        """Begin one episode per seed."""
        self._fleet = PlanarFleet(self._task, len(seeds))
        for robot, seed in enumerate(seeds):
            self._fleet.begin(robot, seed)
        states = self._fleet.states()
        if self._reward is not None:
            self._reward.begin(range(len(seeds)), states)
        return self._observe(), states

    def step(self, actions: Array) -> tuple[NDArray[np.floating], Array, Array, NDArray[np.intp]]:
        """Apply actions (N, 2) for one time step of the task."""
        outcomes = self._fleet.step(actions).copy()
        states, paid = self._fleet.states(), self._fleet.rewards()
        if self._reward is not None:
            paid = self._reward.pay(states, outcomes, paid)
        return self._observe(), states, paid, outcomes

    def _observe(self) -> NDArray[np.floating]:
        return (self._fleet.observations() - self._middle) / self._unit


def evaluate_in_fleet(
    actor: Actor, task: NavigationTask, seeds: Iterable[int], reward: FleetReward | None = None
) -> Episodes[None]:
    """Return one episode of a deterministic policy per seed, simulated in parallel, with the states."""
    return drive_fleet(_ScaledFleet(task, reward), actor.scaled_action, seeds)

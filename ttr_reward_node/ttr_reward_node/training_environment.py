"""The simulated tasks with another reward, as Gymnasium wrappers: the algorithm is left alone (thesis Fig. 3.2).

environment = make_environment(make_reward("sparse", load_navigation_task("car_ttr")))
"""

from __future__ import annotations

import math
from typing import Any, cast

import gymnasium
import numpy as np
from ctrl_rl_core.outcome import Outcome
from ctrl_rl_core.tasks import NavigationTask
from gymnasium import spaces
from numpy.typing import NDArray
from sim_bridge.environments import NavigationEnv
from sim_bridge.world import SimulationOptions

from ttr_reward_node.rewards import Reward

Vector = NDArray[np.float32]

TRAINING_RATE = {"xy": 60, "xz": 120}
"""Physics steps per second while learning [Hz], by plane: a third of the nodes' work, and hardly less exact."""
_TYPICAL = {"theta": 0.5 * math.pi, "psi": 0.25 * math.pi, "v_x": 2.0, "v_z": 2.0, "v": 1.0, "omega": 2.0}
"""What counts as 1 of an observed angle or speed [rad, m/s, rad/s]."""


class RewardWrapper(gymnasium.Wrapper[Vector, Vector, Vector, Vector]):
    """Pays one of the rewards of Table 3.3 instead of the task's own.

    Args:
        environment: of a task of the suite.
        reward: what is paid, for the true state.
    """

    def __init__(self, environment: gymnasium.Env[Vector, Vector], reward: Reward) -> None:
        super().__init__(environment)
        self._reward = reward

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Hold an action for the task's time step."""
        observation, paid, terminated, truncated, info = self.env.step(action)
        # How an episode ends pays what the task says, whichever the reward: the environment has paid it already.
        if not (terminated or truncated):
            paid = self._reward(info["state"][None], np.array([Outcome.RUNNING]))[0]
        return observation, float(paid), terminated, truncated, info


class ScaledObservation(gymnasium.ObservationWrapper[Vector, Vector, Vector]):
    """Observations around 0 and of the order of 1, by fixed numbers: an arena's and the lidar's reach are -2 to 2.

    Attributes:
        middle: what becomes 0, in SI units (n,).
        unit: what becomes 1 above it, in SI units (n,).
    """

    def __init__(self, environment: gymnasium.Env[Vector, Vector], task: NavigationTask) -> None:
        super().__init__(environment)
        self.middle, self.unit = observation_scales(task)
        self.observation_space = spaces.Box(-np.inf, np.inf, self.middle.shape, np.float32)

    def observation(self, observation: Vector) -> Vector:
        """Return the observation in these units (n,)."""
        return cast(Vector, (observation - self.middle) / self.unit)


def observation_scales(task: NavigationTask) -> tuple[Vector, Vector]:
    """Return the middle and the unit of each observed component (n,), (n,), in SI units."""
    assert task.arena is not None
    places = dict(zip(("x", task.plane[1]), task.arena.bounds, strict=True))
    middle, unit = [], []
    for name in task.system.build().state_names:
        place = places.get(name)
        middle.append(0.0 if place is None else place.centre)
        unit.append(_TYPICAL[name] if place is None else 0.25 * place.length)
    beams, reach = task.lidar.beams, task.lidar.range
    middle += [reach.centre] * beams
    unit += [0.25 * reach.length] * beams
    return np.array(middle, dtype=np.float32), np.array(unit, dtype=np.float32)


def make_environment(reward: Reward, rate: int | None = None) -> gymnasium.Env[Vector, Vector]:
    """Return the environment of the reward's task that pays it.

    Args:
        reward: what is paid.
        rate: physics steps per second [Hz]; `TRAINING_RATE` unless given.

    Raises:
        SimulationError: the time step of the task is not a whole number of physics steps.
    """
    task = reward.task
    options = SimulationOptions(rate=TRAINING_RATE[task.plane] if rate is None else rate)
    return ScaledObservation(RewardWrapper(NavigationEnv(task, options=options), reward), task)

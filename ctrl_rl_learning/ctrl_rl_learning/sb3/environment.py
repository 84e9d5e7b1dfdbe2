"""Simulated tasks with normalised observations, and evaluation episodes of a policy in them.

environment = make_environment(load_navigation_task("car_ttr"))
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from sim_bridge.fleet import RATE as FLEET_RATE

from ctrl_rl_core import Actor, Episodes, FunctionDriver, NavigationTask, Outcome, drive
from ctrl_rl_learning.errors import LearningError
from sim_bridge import NavigationEnv, SimulationOptions

Vector = NDArray[np.float32]
Environment = gymnasium.Env[Vector, Vector]

TRAINING_RATE = {"xy": 60, "xz": 120}
"""Physics rate while learning [Hz], by plane: a quarter and a half of the rate for nodes."""
DEPLOYED_RATE = 240
"""Physics rate of the simulated robots that nodes drive [Hz]."""
_TYPICAL = {"theta": 0.5 * math.pi, "psi": 0.25 * math.pi, "v_x": 2.0, "v_z": 2.0, "v": 1.0, "omega": 2.0}
"""Scale of each observed angle or speed: the value that maps to 1 [rad, m/s, rad/s]."""


class ScaledObservation(gymnasium.ObservationWrapper[Vector, Vector, Vector]):
    """Wrapper that scales observations by constants, so that the arena and the lidar's range map to -2 to 2.

    Attributes:
        middle: Observation that maps to 0, in SI units (n,).
        unit: Offset from `middle` that maps to 1, in SI units (n,).
    """

    def __init__(self, environment: Environment, task: NavigationTask) -> None:
        super().__init__(environment)
        self.middle, self.unit = observation_scales(task)
        self.observation_space = spaces.Box(-np.inf, np.inf, self.middle.shape, np.float32)

    def observation(self, observation: Vector) -> Vector:
        """Return the scaled observation (n,)."""
        return cast(Vector, (observation - self.middle) / self.unit)


def observation_scales(task: NavigationTask) -> tuple[Vector, Vector]:
    """Return the offset and the scale of each observed component (n,), (n,), in SI units."""
    if task.corridor is not None:
        raise LearningError(f"task '{task.name}' has a corridor: this way of learning needs an arena or a map")
    own = {state.name: 0.5 * (state.upper - state.lower) for state in task.system.build().states}
    places = task.plane_bounds
    middle, unit = [], []
    for name in task.observed_states:
        place = places.get(name)
        middle.append(0.0 if place is None else place.centre)
        unit.append(_typical(name, own) if place is None else 0.25 * place.length)
    beams, reach = task.lidar.beams, task.lidar.range
    middle += [reach.centre] * beams
    unit += [0.25 * reach.length] * beams
    return np.array(middle, dtype=np.float32), np.array(unit, dtype=np.float32)


def _typical(name: str, own: Mapping[str, float]) -> float:
    """Return the scale of a component: a typical value, or half its range for a user-defined model."""
    return _TYPICAL[name] if name in _TYPICAL else own[name] if math.isfinite(own[name]) else 1.0


def observation_names(task: NavigationTask) -> list[str]:
    """Return the names of the observed components."""
    return [*task.observed_states, *(f"beam_{index}" for index in range(task.lidar.beams))]


def usual_rate(task: NavigationTask, engine: str) -> int:
    """Return the physics rate [Hz] for learning a task in an engine."""
    return (FLEET_RATE if engine == "planar" else TRAINING_RATE)[task.plane]


def make_environment(
    task: NavigationTask, rate: int | None = None, *wrappers: Any, engine: str = "auto"
) -> Environment:
    """Return the environment of a task in an arena or on a map.

    Args:
        task: Task with the rewards.
        rate: Physics rate [Hz]; `usual_rate` by default.
        wrappers: Wrappers applied before the observations are scaled, e.g. to replace the reward.
        engine: Physics engine, one of `sim_bridge.ENGINES`.

    Raises:
        SimulationError: The task's time step is not a whole number of physics steps.
        LearningError: The task has a corridor.
    """
    options = SimulationOptions(engine=engine, rate=usual_rate(task, engine) if rate is None else rate)
    environment: Environment = NavigationEnv(task, options=options)
    for wrap in wrappers:
        environment = wrap(environment)
    return ScaledObservation(environment, task)


SUCCESS = Outcome.GOAL.name


def evaluate(actor: Actor, environment: Environment, episodes: int, seed: int) -> Episodes[Vector]:
    """Return one episode for each of `episodes` seeds, counting up from `seed`, with the states."""
    return drive(environment, FunctionDriver(actor.scaled_action), seeds=range(seed, seed + episodes), keep=True)

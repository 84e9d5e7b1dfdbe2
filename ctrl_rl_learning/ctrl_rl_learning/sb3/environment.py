"""Simulated tasks as learners see them, observations around 0 and of the order of 1, and a policy's episodes in them.

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
"""Physics steps per second while learning [Hz], by plane: a quarter and a half of the nodes' work."""
DEPLOYED_RATE = 240
"""Those of the simulated robots that nodes drive [Hz]."""
_TYPICAL = {"theta": 0.5 * math.pi, "psi": 0.25 * math.pi, "v_x": 2.0, "v_z": 2.0, "v": 1.0, "omega": 2.0}
"""What counts as 1 of an observed angle or speed [rad, m/s, rad/s]."""


class ScaledObservation(gymnasium.ObservationWrapper[Vector, Vector, Vector]):
    """Observations around 0 and of the order of 1, by fixed numbers: an arena's and the lidar's reach are -2 to 2.

    Attributes:
        middle: Observation that becomes 0, in SI units (n,).
        unit: Distance above the middle that becomes 1, in SI units (n,).
    """

    def __init__(self, environment: Environment, task: NavigationTask) -> None:
        super().__init__(environment)
        self.middle, self.unit = observation_scales(task)
        self.observation_space = spaces.Box(-np.inf, np.inf, self.middle.shape, np.float32)

    def observation(self, observation: Vector) -> Vector:
        """Return the observation in these units (n,)."""
        return cast(Vector, (observation - self.middle) / self.unit)


def observation_scales(task: NavigationTask) -> tuple[Vector, Vector]:
    """Return the middle and the unit of each observed component (n,), (n,), in SI units."""
    if task.corridor is not None:
        raise LearningError(f"task '{task.name}' has a corridor: an arena or a map is needed to learn this way")
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
    """Return the unit of a component; half of its range for one of a model of one's own."""
    return _TYPICAL[name] if name in _TYPICAL else own[name] if math.isfinite(own[name]) else 1.0


def observation_names(task: NavigationTask) -> list[str]:
    """Return the names of the observed components."""
    return [*task.observed_states, *(f"beam_{index}" for index in range(task.lidar.beams))]


def usual_rate(task: NavigationTask, engine: str) -> int:
    """Return the physics steps per second [Hz] while learning a task in an engine."""
    return (FLEET_RATE if engine == "planar" else TRAINING_RATE)[task.plane]


def make_environment(
    task: NavigationTask, rate: int | None = None, *wrappers: Any, engine: str = "auto"
) -> Environment:
    """Return the environment of a task in an arena or on a map.

    Args:
        task: Task with the rewards.
        rate: Physics steps per second [Hz]; `usual_rate` unless given.
        wrappers: Functions called with the environment before its observations are scaled, e.g. to pay something else.
        engine: Physics engine, one of `sim_bridge.ENGINES`.

    Raises:
        SimulationError: the time step of the task is not a whole number of physics steps.
        LearningError: the task has a corridor.
    """
    options = SimulationOptions(engine=engine, rate=usual_rate(task, engine) if rate is None else rate)
    environment: Environment = NavigationEnv(task, options=options)
    for wrap in wrappers:
        environment = wrap(environment)
    return ScaledObservation(environment, task)


SUCCESS = Outcome.GOAL.name


def evaluate(actor: Actor, environment: Environment, episodes: int, seed: int) -> Episodes[Vector]:
    """Run one episode for each seed from `seed` on, and return them with their states."""
    return drive(environment, FunctionDriver(actor.scaled_action), seeds=range(seed, seed + episodes), keep=True)

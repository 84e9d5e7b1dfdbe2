"""The safety filter as a Gymnasium wrapper, with a choice of how corrections are reported to the learner.

environment = Shield(NavigationEnv(with_whole_scan(task), options=SETTINGS), model)
environment = shielded_environment(task, model)    # the same with the task's own beams, scaled for learning
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import gymnasium
import numpy as np
from ctrl_rl_core.sensing import nearest_beams
from ctrl_rl_learning.sb3 import Environment, ScaledObservation, Vector
from gymnasium import spaces

from ctrl_rl_core import NavigationTask, ScanGeometry
from ctrl_rl_safety.filter.verdict import FilterOptions
from ctrl_rl_safety.models.robot_model import RobotModel
from ctrl_rl_safety.trials.episodes import filter_of
from ctrl_rl_safety.trials.robot import MOTOR_LAG, TrialRobot
from ctrl_rl_safety.trials.worlds import with_whole_scan
from sim_bridge import NavigationEnv, SimulationOptions

SETTINGS = SimulationOptions(engine="planar", rate=20, scan_rate=5.0, motor_lag=MOTOR_LAG)
"""Simulation settings for training: few physics steps and scans, which take most of the time."""


@dataclass(frozen=True)
class ShieldOptions:
    """Settings of a shield.

    Attributes:
        active: Whether commands are filtered; if not, the robot moves in the same way but may collide.
        told: Action reported to the learner: its own ("raw"), the one sent in its place ("sent"), or its own with a
            lower reward if they differ ("penalty").
        penalty: Reward deducted per step for a difference of half a command's range.
        mover_speed: Maximum speed of movers [m/s].
        period: Period of the filter, which must divide the task's time step [s].
    """

    active: bool = True
    told: Literal["raw", "sent", "penalty"] = "raw"
    penalty: float = 20.0
    mover_speed: float = 0.0
    period: float = 0.1


class Shield(gymnasium.Wrapper[Vector, Vector, Vector, Vector]):
    """An environment in which the filter replaces the raw action several times per step.

    Info additionally has `told_action`, the action (2,) that the learner should store (`ToldActions` writes it to PPO's
    buffer); `changed`, the fraction of commands changed by the filter; and `avoidable`, whether the episode ended in a
    contact that the robot could have avoided.
    """

    def __init__(self, environment: NavigationEnv, model: RobotModel, options: ShieldOptions | None = None) -> None:
        """Add a filter to a wheeled robot.

        Args:
            environment: Environment with a 360 degree lidar and the `motor_lag` of `SETTINGS`.
            model: Constants of the robot, which its base then follows.
            options: Settings of the shield; the default ones if omitted.
        """
        super().__init__(environment)
        self._inner, self._model, self._options = environment, model, options or ShieldOptions()
        self._robot: TrialRobot | None = None
        low, high = np.array(list(environment.task.robot.commands.values())).T
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Vector, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        world, period = self._inner.world, self._options.period
        settings = FilterOptions(period=period, mover_speed=self._options.mover_speed)
        make_filter = partial(filter_of, world, self._model, settings, math.inf) if self._options.active else None
        self._robot = TrialRobot(world, self._model, make_filter, tick=period)
        return observation, info

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Apply an action (2,) for the task's time step, as far as the filter allows."""
        assert self._robot is not None, "reset before the first step"
        raw = self._inner.command_of(action)
        ticks, changed = self._robot.ticks, self._robot.changed
        sent = self._robot.hold(raw, self._inner.task.episode.time_step)
        observation, reward, terminated, truncated, info = self._inner.result()
        own = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        given = np.clip((sent - self._middle) / self._half, -1.0, 1.0)
        if self._options.told == "penalty":
            reward -= self._options.penalty * float(np.abs(given - own).sum())
        info["told_action"] = (given if self._options.told == "sent" else np.asarray(action)).astype(np.float32)
        info["avoidable"] = self._robot.avoidable
        info["changed"] = (self._robot.changed - changed) / (self._robot.ticks - ticks)
        return observation, reward, terminated, truncated, info


class TaskBeams(gymnasium.ObservationWrapper[Vector, Vector, Vector]):
    """Selects the beams of a task's own lidar from a 360 degree lidar."""

    def __init__(
        self, environment: gymnasium.Env[Vector, Vector], task: NavigationTask, around: NavigationTask
    ) -> None:
        super().__init__(environment)
        states, lidar = len(task.observed_states), around.lidar
        geometry = ScanGeometry(lidar.beams, lidar.angle_min, lidar.angle_increment, *lidar.range)
        bearings = task.lidar.angle_min + task.lidar.angle_increment * np.arange(task.lidar.beams, dtype=np.float64)
        self._kept = np.concatenate((np.arange(states), states + nearest_beams(geometry, bearings)[1]))
        space = environment.observation_space
        assert isinstance(space, spaces.Box)
        self.observation_space = spaces.Box(space.low[self._kept], space.high[self._kept])

    def observation(self, observation: Vector) -> Vector:
        """Return the state and the beams (n,)."""
        return observation[self._kept]


def shielded_environment(
    task: NavigationTask, model: RobotModel, options: ShieldOptions | None = None, *wrappers: Any
) -> Environment:
    """Create the environment of an arena task behind a shield, wrapped for learning.

    Args:
        task: Task of a wheeled robot.
        model: Constants of the robot.
        options: Settings of the shield; the default ones if omitted.
        wrappers: Functions called with the environment before its observations are scaled.
    """
    around = with_whole_scan(task)
    environment: Any = Shield(NavigationEnv(around, options=SETTINGS), model, options)
    for wrap in wrappers:
        environment = wrap(environment)
    return ScaledObservation(TaskBeams(environment, task, around), task)

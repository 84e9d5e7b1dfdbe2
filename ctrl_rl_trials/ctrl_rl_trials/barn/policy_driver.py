"""Policies of the suite that were learnt for other tasks, as drivers of the benchmark."""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.sensing import planar
from ctrl_rl_navigation.robot import DriveLimits
from numpy.typing import NDArray

from ctrl_rl_core import PolicyDriver, Sensors, find_policy, load_navigation_task, load_policy, make_odometry
from ctrl_rl_trials.barn.scenarios import Scenario

Array = NDArray[np.float64]


class TransplantedPolicy:
    """A policy that was learnt for another task, as it is: its goal is put on the goal, and the start beside it.

    A policy that asks for no pose drives by its lidar alone.
    """

    def __init__(self, name: str, scenario: Scenario, _: DriveLimits) -> None:
        self._policy = load_policy(find_policy(name))
        task = load_navigation_task(name)
        self._driver, self._decided_at = PolicyDriver(self._policy), -math.inf
        self._goal: Array | None = None
        self._turn, self._shift = 0.0, np.zeros(2)
        if "pose" in self._policy.needs or "goal" in self._policy.needs:
            (x, y), (start_x, start_y) = task.goal.region.position, task.start.region.position
            here = math.atan2(scenario.goal[1] - scenario.start[1], scenario.goal[0] - scenario.start[0])
            self._turn = math.atan2(y - start_y, x - start_x) - here
            self._shift = np.array((x, y)) - _turned(np.array(scenario.goal), self._turn)
            self._goal = np.array((x, y, 0.0))

    def command(self, sensors: Sensors) -> Array:  # noqa: D102 - see Driver
        policy, period = self._policy, self._policy.period
        if period is not None and sensors.time - self._decided_at < period - 1e-6:
            return sensors.command
        self._decided_at = sensors.time
        x, y, theta = planar(sensors.odometry[:7].tolist())
        place = _turned(np.array((x, y)), self._turn) + self._shift
        v, omega = sensors.speeds
        odometry = make_odometry(np.array((*place, theta + self._turn)), np.array((v, 0.0, omega)))
        goal = self._goal if "goal" in policy.needs else None
        return self._driver.command(sensors._replace(odometry=odometry, pose=planar(odometry[:7].tolist()), goal=goal))


def _turned(place: Array, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array((c * place[0] - s * place[1], s * place[0] + c * place[1]))

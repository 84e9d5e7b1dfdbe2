"""Policies of the suite that were learnt for other tasks, as controllers of the benchmark."""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.sensing.pose import planar
from ctrl_rl_navigation.robot import DriveLimits
from numpy.typing import NDArray

from ctrl_rl_core import CtrlRlError, Sensors, find_policy, load_navigation_task, load_policy, make_odometry
from ctrl_rl_trials.barn.drive import Sensed
from ctrl_rl_trials.barn.scenarios import Scenario

Array = NDArray[np.float64]


class PolicyDriver:
    """A policy that was learnt for another task, as it is: its goal is put on the goal, and the start beside it.

    A policy that asks for no pose drives by its lidar alone.
    """

    def __init__(self, name: str, scenario: Scenario, _: DriveLimits) -> None:
        self._policy = load_policy(find_policy(name))
        task = load_navigation_task(name)
        self._command, self._decided_at = self._policy.rest, -math.inf
        self._goal: Array | None = None
        self._turn, self._shift = 0.0, np.zeros(2)
        if "pose" in self._policy.needs or "goal" in self._policy.needs:
            (x, y), (start_x, start_y) = task.goal.region.position, task.start.region.position
            here = math.atan2(scenario.goal[1] - scenario.start[1], scenario.goal[0] - scenario.start[0])
            self._turn = math.atan2(y - start_y, x - start_x) - here
            self._shift = np.array((x, y)) - _turned(np.array(scenario.goal), self._turn)
            self._goal = np.array((x, y, 0.0))

    def decide(self, sensed: Sensed) -> Array:  # noqa: D102
        period = self._policy.period
        if period is not None and sensed.now - self._decided_at < period - 1e-6:
            return self._command
        self._decided_at = sensed.now
        place = _turned(sensed.pose[:2], self._turn) + self._shift
        pose = np.array((*place, sensed.pose[2] + self._turn))
        odometry = make_odometry(pose, np.array((sensed.motion[0], 0.0, sensed.motion[1])))
        goal = self._goal if "goal" in self._policy.needs else None
        try:
            here = planar(odometry[:7].tolist())
            given = Sensors(sensed.ranges, sensed.geometry, odometry, here, goal, self._command)
            self._command = np.clip(self._policy.command(given), *self._policy.limits)
        except CtrlRlError:
            return self._policy.rest
        return self._command

    def sent(self, command: Array) -> None:  # noqa: D102
        self._command = np.array(command, float)


def _turned(place: Array, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array((c * place[0] - s * place[1], s * place[0] + c * place[1]))

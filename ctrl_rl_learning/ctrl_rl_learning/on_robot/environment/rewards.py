"""The reward of a step on a robot: seconds of progress by the time to reach, and what the task pays at the end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from ttr_reward_node.rewards import Progress

from ctrl_rl_core import NavigationTask, OdometryReader, Outcome, Sensors, terminal_reward
from ctrl_rl_learning.errors import LearningError
from ttr_reward_node import TimeToReach

Array = NDArray[np.float64]
_POSE = ("x", "y", "theta")


class StateReader:
    """Reads the state of a task's system from sensors: x, y and theta from the pose, all else from odometry."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._places = [(row, _POSE.index(name)) for row, name in enumerate(names) if name in _POSE]
        self._odometry = OdometryReader(names)

    def __call__(self, sensors: Sensors) -> Array:
        """Return the state (n,).

        Raises:
            LearningError: There is no pose.
        """
        if sensors.pose is None:
            raise LearningError("no pose: which part of the way is done is unknown")
        state = np.array(self._odometry(sensors.odometry), dtype=np.float64)
        for row, place in self._places:
            state[row] = sensors.pose[place]
        return state


class StepReward:
    """Rewards of an episode: the seconds by which each step brings the goal nearer, and the task's at its end."""

    def __init__(self, task: NavigationTask, value: TimeToReach) -> None:
        """Make the reward of a task.

        Args:
            task: Task with the rewards of the outcomes.
            value: Time to reach of the task's goal.
        """
        self._rewards, self._value = task.rewards, value
        self._progress = Progress(value.longest)

    def begin(self, state: Array) -> None:
        """Begin an episode in a state (n,)."""
        self._progress.begin(self._seconds(state))

    def step(self, state: Array, outcome: Outcome) -> float:
        """Return the reward of a step that led to a state (n,)."""
        if outcome is not Outcome.RUNNING:
            return float(terminal_reward(outcome, self._rewards))
        return float(self._progress.step(self._seconds(state), ended=False))

    def _seconds(self, state: Array) -> float:
        return float(self._value.times(state[None])[0])

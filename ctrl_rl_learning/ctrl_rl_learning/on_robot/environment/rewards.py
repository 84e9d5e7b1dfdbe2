"""Step rewards on a robot: progress in the time to reach [s], plus the task's terminal reward."""

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
    """Reads a system's state from sensors: x, y and theta from the pose, everything else from odometry."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._places = [(row, _POSE.index(name)) for row, name in enumerate(names) if name in _POSE]
        self._odometry = OdometryReader(names)

    def __call__(self, sensors: Sensors) -> Array:
        """Return the state (n,).

        Raises:
            LearningError: There is no pose.
        """
        if sensors.pose is None:
            raise LearningError("no pose: progress towards the goal is unknown")
        state = np.array(self._odometry(sensors.odometry), dtype=np.float64)
        for row, place in self._places:
            state[row] = sensors.pose[place]
        return state


class StepReward:
    """Rewards of an episode: the decrease of the time to reach in each step [s], and the task's terminal reward."""

    def __init__(self, task: NavigationTask, value: TimeToReach) -> None:
        """Create the reward of a task.

        Args:
            task: Task, which defines the reward of each outcome.
            value: Time to reach the task's goal.
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

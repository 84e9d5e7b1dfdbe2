"""Value functions at the states of transitions: what a state is worth, and the advantage of what was done there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from ctrl_rl_core.tasks import SystemSpec, with_grid
from numpy.typing import NDArray
from ttr_reward_node.rewards import longest_time

from ctrl_rl_core import NavigationTask, ValueFunction
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.transitions import Transitions
from oc_baseline_node import find_value
from oc_baseline_node import load_value as load_oc_value
from ttr_reward_node import find_or_solve, load_value

Array = NDArray[np.float64]
TIME_TO_REACH, OC_VALUE = "time_to_reach", "oc_value"
_COLLISION_S = 10.0
"""Time that a collision costs beside the longest way [s]."""


class StateValues:
    """Value of states by one of the suite's functions, the larger the better.

    Attributes:
        name: Kind of the function.
        counts_time: Whether values are times to reach [s].
        unit: Reward of a step without outcome: -dt by the time to reach [s], 0 by the optimal control value.
    """

    def __init__(self, function: ValueFunction, task: NavigationTask) -> None:
        """Take a function.

        Raises:
            LearningError: It is of another kind, or of another system.
        """
        if function.kind not in (TIME_TO_REACH, OC_VALUE):
            raise LearningError(f"the value function holds '{function.kind}': a time to reach or V_oc is needed")
        if function.state_names != task.system.build().state_names:
            raise LearningError(f"the value function's states are {', '.join(function.state_names)}, not the task's")
        self.name = function.kind
        self._function, self._task = function, task
        self.counts_time = function.kind == TIME_TO_REACH
        self.unit = -task.episode.time_step if self.counts_time else 0.0
        self._longest = longest_time(function)
        self._least = 0.0 if self.counts_time else float(task.rewards.collision)
        optimal = task.optimal_control
        self._discount = 1.0 if optimal is None else optimal.discount

    def __call__(self, states: Array) -> Array:
        """Return values (N,) of states (N, d): minus the time to reach [s], or V_oc [reward]."""
        values = np.asarray(self._function.value(states), dtype=np.float64)
        if self.counts_time:
            return -np.where(np.isfinite(values), values, self._longest)
        return np.where(np.isfinite(values), values, self._least)

    def after(self, transitions: Transitions) -> Array:
        """Return reward and value of what follows each transition (N,)."""
        following = self(transitions.next_states)
        if self.counts_time:
            ends = np.where(transitions.outcomes == 1, 0.0, -self._longest - _COLLISION_S)
            return self.unit + np.where(transitions.done, ends, following)
        return np.where(transitions.done, transitions.task_rewards, self._discount * following)

    def after_step(self, middles: Array, ends: Array) -> Array:
        """Return reward and value of steps (N,) by the states half way (N, d) and at their ends (N, d)."""
        blocked = ~(np.isfinite(self._function.value(middles)) & np.isfinite(self._function.value(ends)))
        if self.counts_time:
            return self.unit + np.where(blocked, -self._longest - _COLLISION_S, self(ends))
        return np.where(blocked, float(self._task.rewards.collision), self._discount * self(ends))

    def advantages(self, transitions: Transitions) -> Array:
        """Return how much better each transition (N,) was than its state: 0 for the best there is [s or reward]."""
        return self.after(transitions) - self(transitions.states)


def load_values(name_or_path: str, task: NavigationTask, folder: Path, clearance: float = 0.0) -> StateValues:
    """Return the values of a file, of a task's time to reach (`time_to_reach`), or of its shipped V_oc (`oc_value`).

    Only a time to reach that is solved here keeps the clearance [m] to obstacles.

    Raises:
        CtrlRlError: There is no such function, or it does not fit the task.
    """
    if name_or_path == TIME_TO_REACH:
        return StateValues(load_value(find_time_to_reach(task, folder, clearance)), task)
    if name_or_path == OC_VALUE:
        return StateValues(load_oc_value(find_value(task.name)), task)
    return StateValues(load_oc_value(Path(name_or_path)), task)  # which reads value grids, too


def clearance_of(task: NavigationTask, asked: float | None) -> float:
    """Return the room to obstacles of a value that teaches [m]: half the body's radius unless asked."""
    return 0.5 * task.robot.radius if asked is None else asked


def find_time_to_reach(task: NavigationTask, folder: Path, clearance: float = 0.0) -> Path:
    """Return the file of the time to reach by what the robot can do, solved now unless it is there.

    Controls are the robot's commands. A task without a grid gets that of `with_grid`.

    Raises:
        TimeToReachError: There is no grid, or nothing reaches its goal.
    """
    return find_or_solve(task, folder, posed_as=solvable(task), clearance=clearance)


def solvable(task: NavigationTask) -> NavigationTask:
    """Return the task with the controls of its robot, and with a grid."""
    changes: dict[str, object] = {}
    system = task.system
    if set(task.robot.commands) == set(system.controls):
        units = {"v": "m/s", "omega": "rad/s"}
        controls = {name: f"{low} .. {high} {units[name]}" for name, (low, high) in task.robot.commands.items()}
        changes["system"] = SystemSpec(
            model=system.model, parameters=system.parameters, controls=controls, states=system.states
        )
    return with_grid(task.model_copy(update=changes))

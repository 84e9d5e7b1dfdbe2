"""Rewards of thesis Table 3.3: time-to-reach (Eq. 3.9), sparse, and distance with four weights of the angle.

    reward = make_reward("ttr", load_navigation_task("car_ttr"), ValueGrid.load("car_ttr.safetensors"))
    reward(states, outcomes)                 # (N, n), (N,) -> (N,)

An intermediate state pays -phi(x), 0 or -d(x); the end of an episode pays the same for all rewards, as set in the task.

Two rules complete Eq. 3.9. A state outside the domain of the value function (e.g. a quadrotor faster than the grid's
limit) is looked up at the nearest state inside. A state from which the goal cannot be reached (phi = +inf), or without
a value (NaN), counts as the longest finite time: a larger penalty, e.g. that of a whole episode, makes robots stop
short of a goal with such states next to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.tasks import ANGLES, wrap
from ctrl_rl_core.values import check_function
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import NavigationTask, Outcome, Region, TaskSets, ValueFunction, position_indices, terminal_reward
from ttr_reward_node.errors import TimeToReachError

Array = NDArray[np.float64]

KIND = "time_to_reach"
"""Kind of value function required by the rewards."""
DISTANCE_WEIGHTS = {"distance_0": 0.0, "distance_0.1": 0.1, "distance_1": 1.0, "distance_10": 10.0}
"""Weight lambda of the squared angle [m^2/rad^2] by reward name."""
REWARDS = ("sparse", *DISTANCE_WEIGHTS, "ttr")
"""Rewards of Table 3.3 by name."""
PROGRESS = "ttr_progress"
"""Name of the reward for best progress in the time to reach, see `progress`."""
TRAINING_REWARDS = (PROGRESS, *REWARDS)
"""Rewards available for training."""


def time_to_reach_reward(phi: ArrayLike, longest: float) -> Array:
    """Return -phi (Eq. 3.9, s in I).

    Args:
        phi: Times to reach (N,) [s]; +inf if the goal cannot be reached, NaN if unknown.
        longest: Largest time to reach [s]; phi is clipped to it, and +inf and NaN are replaced by it.

    Returns:
        Rewards (N,) from -longest to 0.
    """
    times = np.asarray(phi, dtype=float)
    return -np.clip(np.where(np.isnan(times), longest, times), 0.0, longest)


def distance_reward(states: ArrayLike, names: Sequence[str], goal: Region, weight: float) -> Array:
    """Return -d (Table 3.3): minus the Euclidean distance to the centre of the goal, with a weighted angle.

    Args:
        states: States (N, n) in SI units.
        names: Names of the state's components.
        goal: Region with a disc or intervals of two positions and, if `weight` is not 0, an interval of one angle.
        weight: Weight lambda of the squared angle [m^2/rad^2].

    Raises:
        TimeToReachError: The goal has no such centre.
    """
    states = np.asarray(states, dtype=float)
    positions, angles = _middle(names, goal, weight)
    squared = np.zeros(states.shape[:-1])
    for name, centre in positions.items():
        squared += (states[..., names.index(name)] - centre) ** 2
    for name, centre in angles.items():
        squared += weight * wrap(states[..., names.index(name)] - centre) ** 2
    return -np.sqrt(squared)


def _middle(names: Sequence[str], goal: Region, weight: float) -> tuple[dict[str, float], dict[str, float]]:
    """Return the centre of a goal: two positions by name and, if `weight` is not 0, an angle by name.

    Raises:
        TimeToReachError: The goal has no centre.
    """
    angles = {name: goal.intervals[name].centre for name in goal.intervals if name in ANGLES} if weight else {}
    positions = {name: goal.intervals[name].centre for name in goal.intervals if name in ("x", "y", "z")}
    if goal.disc is not None:
        positions = dict(zip((names[k] for k in position_indices(names)), goal.disc.centre, strict=True))
    if len(positions) != 2:
        raise TimeToReachError("a distance reward needs a goal with a disc, or with intervals of two positions")
    if weight and len(angles) != 1:
        raise TimeToReachError("a distance reward that weighs the angle needs a goal with an interval of one angle")
    return positions, angles


@dataclass(frozen=True)
class Reward:
    """Reward of a task, created by `make_reward`.

    Attributes:
        name: Name of the reward, one of `REWARDS`.
        task: Task of the reward.
        value: Time-to-reach function of the task; None for the other rewards.
        domain: Lower and upper bounds of states (2, n) at which the value is looked up, infinite if unbounded.
        longest: Largest finite time to reach of the function [s].
    """

    name: str
    task: NavigationTask
    value: ValueFunction | None
    domain: Array
    longest: float

    def intermediate(self, states: ArrayLike) -> Array:
        """Return the rewards (N,) of states (N, n) during an episode."""
        states = np.asarray(states, dtype=float)
        if self.value is not None:
            return time_to_reach_reward(self.value.value(np.clip(states, *self.domain)), self.longest)
        if self.name == "sparse":
            return np.zeros(states.shape[:-1])
        names = self.task.system.build().state_names
        return distance_reward(states, names, self.task.goal.region, DISTANCE_WEIGHTS[self.name])

    def __call__(self, states: ArrayLike, outcomes: ArrayLike, tilted: ArrayLike = False) -> Array:
        """Return the rewards (N,) of states (N, n) for the outcomes (N,) of their episodes."""
        running = np.asarray(outcomes) == Outcome.RUNNING
        return np.where(running, self.intermediate(states), terminal_reward(outcomes, self.task.rewards, tilted))


def make_reward(name: str, task: NavigationTask, value: ValueFunction | None = None) -> Reward:
    """Create a reward of Table 3.3.

    Args:
        name: Name of the reward, one of `REWARDS`.
        task: Task of the reward.
        value: Time-to-reach function of the task; required only by "ttr".

    Raises:
        TimeToReachError: There is no such reward; "ttr" without an informative value; a distance to a goal without a
            centre.
        ValueFunctionError: The value does not belong to the task.
    """
    if name not in REWARDS:
        raise TimeToReachError(f"no reward '{name}': there are {', '.join(REWARDS)}")
    if name == "ttr" and value is None:
        raise TimeToReachError("the reward 'ttr' needs the task's time to reach: solve the task first")
    if name in DISTANCE_WEIGHTS:
        _middle(task.system.build().state_names, task.goal.region, DISTANCE_WEIGHTS[name])
    used = value if name == "ttr" else None
    if used is not None and not check_function(used, task, KIND):
        raise TimeToReachError(
            f"the time to reach belongs to another version of task '{task.name}': solve the task again"
        )
    if used is not None:
        check_informative(used)
    return Reward(name, task, used, value_domain(used, task.system.build().state_names), longest_time(used))


def check_informative(value: ValueFunction) -> None:
    """Reject a time-to-reach function without any path to the goal: its reward would be constant.

    Raises:
        TimeToReachError: It is finite only in the goal.
    """
    if longest_time(value) == 0.0:
        raise TimeToReachError(
            f"by the time to reach of task '{value.task}' nothing outside the goal reaches it, so its reward would be "
            "0 everywhere: correct the task and solve it again"
        )


def longest_time(value: ValueFunction | None) -> float:
    """Return the largest finite time in the grids of a value [s]."""
    grids = () if value is None else value.grids
    return max((float(grid.values.max(initial=0.0, where=np.isfinite(grid.values))) for grid in grids), default=0.0)


def value_domain(value: ValueFunction | None, names: Sequence[str]) -> Array:
    """Return the bounds (2, n) of the grids of a value; infinite along a periodic axis."""
    domain = np.tile([[-np.inf], [np.inf]], (1, len(names)))
    for grid in () if value is None else value.grids:
        for axis in grid.axes:
            if not axis.periodic:
                index = names.index(axis.name)
                domain[0, index] = max(domain[0, index], axis.lower)
                domain[1, index] = min(domain[1, index], axis.upper)
    return domain


class EvaluatedReward(NamedTuple):
    """Outcome of a state and its reward; NaN for an intermediate state outside the value function."""

    outcome: Outcome
    reward: float


class RewardEvaluator:
    """Evaluates the rewards of states of one task.

    Args:
        task: Task with the rewards and the sets G and C.
        function: Time-to-reach function of the task.
        width: Width of the task's corridor [m], None for its own.

    Attributes:
        up_to_date: Whether the function was computed for the same version of the task.

    Raises:
        TaskError: The width does not fit the task.
        ValueFunctionError: The function does not belong to the task.
        TimeToReachError: No state outside the goal can reach it, according to the function.
    """

    def __init__(self, task: NavigationTask, function: ValueFunction, width: float | None = None) -> None:
        self.up_to_date = check_function(function, task, KIND)
        check_informative(function)
        self._sets = TaskSets(task, width)
        self._rewards = task.rewards
        self._longest = longest_time(function)

    def __call__(self, state: NDArray[np.float64], phi: float) -> EvaluatedReward:
        """Return outcome and reward of a state (n,) with time to reach phi [s], which may be +inf or NaN."""
        outcome = Outcome(int(self._sets.outcomes(state)))
        if outcome is not Outcome.RUNNING:
            return EvaluatedReward(outcome, float(terminal_reward(outcome, self._rewards)))
        # A learner needs a number even for unknown values; on a topic, NaN shows that the value is unknown.
        return EvaluatedReward(
            outcome, math.nan if math.isnan(phi) else float(time_to_reach_reward(phi, self._longest))
        )

"""Alternatives to the time to reach: time to go by distance, and by MPC's trajectories."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
from ctrl_rl_core.tasks import OptimalControlSpec
from numpy.typing import NDArray
from oc_baseline_node.problems import TIME_STEP_RANGE
from scipy.spatial import KDTree

from ctrl_rl_core import NavigationTask, Outcome, TaskSets, position_indices, signed_distance
from ctrl_rl_trials.shaping.variants import GAMMA
from oc_baseline_node import DataSettings, OptimalControlProblem, ValueData, formulate, load_data

Array = NDArray[np.float64]
_FLIGHT = 2.0
"""Speed for converting distance to time if no command is a speed [m/s]."""


def top_speed(task: NavigationTask) -> float:
    """Return the speed at which a distance counts as time [m/s]."""
    return max(map(abs, task.robot.commands["v"])) if "v" in task.robot.commands else _FLIGHT


class DistanceInSeconds:
    """Time along the straight line to the centre of the goal at the robot's maximum speed."""

    def __init__(self, task: NavigationTask) -> None:
        names = task.system.build().state_names
        self._first, self._second = position_indices(names)
        self._goal = task.goal.region.position
        self._speed = top_speed(task)
        corners = [
            (x, y) for x in task.plane_bounds[names[self._first]] for y in task.plane_bounds[names[self._second]]
        ]
        self.longest = max(math.dist(corner, self._goal) for corner in corners) / self._speed

    def times(self, states: Array) -> Array:  # noqa: D102 - see Potential
        offset = states[:, [self._first, self._second]] - self._goal
        return np.hypot(offset[:, 0], offset[:, 1]) / self._speed


TRAJECTORIES = 300
"""Number of trajectories to solve per task, from random starts."""
_STEPS = 100
"""Number of steps per trajectory."""
_NEIGHBOURS = 32
_LEAST_RATE = 1e-6
_LOOKS = np.linspace(0.0, 1.0, 8)[:-1]
"""Fractions of the segment to a neighbour at which to check for obstacles."""


def pose(task: NavigationTask) -> OptimalControlProblem:
    """Return the optimal control problem for a task's time to go, formulated by the same rule for all tasks.

    All steps of a trajectory have one free length, and the longest trajectory lasts an episode. The state cost is
    bounded and outweighs the control cost by far, so that trajectories are fast. A trap is not an obstacle, as in the
    time to reach.

    Raises:
        OcError: MPC cannot handle such a world.
    """
    longest = task.episode.steps * task.episode.time_step
    spec = OptimalControlSpec.model_validate(
        {
            "horizon": _STEPS,
            "time_step": f"{longest / (_STEPS * TIME_STEP_RANGE[1])!r} s",
            "gamma": 1.0,
            "discount": GAMMA,
            "state_weight": 10.0,
            "control_weight": 0.1,
            "clearance": "0 m",
            "trajectories": TRAJECTORIES,
            "controls": {},
            "bounds": {},
        }
    )
    return formulate(task.model_copy(update={"optimal_control": spec}), "free_time")


def find_or_solve_trajectories(task: NavigationTask, folder: Path, workers: int = 1) -> Path:
    """Return the folder of MPC's trajectories for this version of a task, after solving the missing ones.

    Args:
        task: Task in an arena.
        folder: Folder with one subfolder per task.
        workers: Number of solver processes.

    Raises:
        OcError: MPC cannot handle such a world, or finds hardly any trajectory to the goal.
        LockError: Another call is using the folder.
    """
    # Only this step needs CasADi: with the trajectories at hand, training works without it.
    from oc_baseline_node import make_data

    problem = pose(task)
    own = folder / f"{task.name}-{problem.digest[:12]}-mpc"
    make_data(problem, DataSettings(TRAJECTORIES), own, workers)
    return own


class TimeToGo:
    """Time to go by the trajectories of `find_or_solve_trajectories`.

    The time to go is the minimum, over the nearest visible trajectory states, of the travel time to that state (at the
    highest rates in the trajectories) plus the state's remaining time to the goal. A network would smooth the jumps of
    this function at walls.

    Args:
        folder: Folder of the trajectories.
        task: Task of the trajectories.

    Attributes:
        longest: Time of the longest trajectory [s].
        digest: SHA-256 of the trajectories.

    Raises:
        OcError: The trajectories belong to another task, or some are missing.
    """

    def __init__(self, folder: Path, task: NavigationTask) -> None:
        problem = pose(task)
        data = load_data(folder, problem)
        left, met = _time_left(task, data)
        self.longest = float(left.max())
        self.digest = hashlib.sha256(data.states.tobytes() + data.time_steps.tobytes()).hexdigest()
        steps = data.time_steps[:, None, None]
        self._rates = np.maximum(np.max(np.abs(np.diff(data.states, axis=1)) / steps, axis=(0, 1)), _LEAST_RATE)
        self._angles = np.array([each.periodic for each in problem.system.states])
        self._tree = KDTree(self._in_seconds(data.states[met]))
        self._left, self._places = left[met], data.states[met][:, problem.positions]
        self._positions, self._obstacles = problem.positions, problem.obstacles

    def times(self, states: Array) -> Array:
        """Return the times to go (N,) from states (N, n) [s]; +inf where no trajectory state is visible."""
        apart, index = self._tree.query(self._in_seconds(states), k=_NEIGHBOURS)
        way = self._places[index] - states[:, None, self._positions]
        between = states[:, None, None, self._positions] + _LOOKS[:, None] * way[:, :, None]
        blocked = np.any(signed_distance(self._obstacles, between) <= 0.0, axis=-1)
        least = np.min(np.where(blocked, np.inf, self._left[index] + apart), axis=1)
        return np.where(least <= self.longest, least, np.inf)

    def _in_seconds(self, states: Array) -> Array:
        """Return states (N, n) as coordinates (N, m) [s], scaled by the highest rates; angles map to a circle."""
        angles, rates = states[:, self._angles], self._rates[self._angles]
        straight = states[:, ~self._angles] / self._rates[~self._angles]
        return np.concatenate((straight, np.cos(angles) / rates, np.sin(angles) / rates), axis=1)


def _time_left(task: NavigationTask, data: ValueData) -> tuple[Array, NDArray[np.bool_]]:
    """Return the time to the first state in the goal (N, H+1) [s], and which states are not after it."""
    arrived = np.argmax(TaskSets(task).outcomes(data.states) == Outcome.GOAL, axis=1)
    steps = arrived[:, None] - np.arange(data.states.shape[1])
    return np.maximum(steps, 0) * data.time_steps[:, None], steps >= 0

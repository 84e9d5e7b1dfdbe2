"""Classifies states: goal G, collision C, trap Tr, or intermediate I (thesis Eq. 3.9, 3.15, 3.17).

The classification is purely geometric, so it also works on a real robot: the body counts as a disc, and time is
ignored.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.geometry.shapes import ArcPath, World
from ctrl_rl_core.tasks.outcome import Outcome
from ctrl_rl_core.tasks.regions import Region, position_indices, wrap
from ctrl_rl_core.tasks.task import NavigationTask

PATH_NAMES = ("s", "lateral", "heading")
"""Components of the regions in a corridor task."""


class PathCoordinates:
    """Path coordinates of poses, computed from precomputed samples of the path."""

    _STEP = 0.01

    def __init__(self, path: ArcPath) -> None:
        self._s = np.linspace(0.0, path.length, max(2, math.ceil(path.length / self._STEP) + 1))
        self._poses = path.pose(self._s)

    def __call__(self, pose: ArrayLike) -> NDArray[np.float64]:
        """Return s [m], lateral offset [m] and heading [rad] (3,) of a pose x, y, theta (3,)."""
        x, y, theta = np.asarray(pose, dtype=float)
        dx, dy = x - self._poses[:, 0], y - self._poses[:, 1]
        nearest = int(np.argmin(dx * dx + dy * dy))
        direction = self._poses[nearest, 2]
        c, s = math.cos(direction), math.sin(direction)
        along, lateral = c * dx[nearest] + s * dy[nearest], c * dy[nearest] - s * dx[nearest]
        along = min(max(self._s[nearest] + along, 0.0), self._s[-1])
        return np.array((along, lateral, float(wrap(theta - direction))))


class TaskSets:
    """The sets of one navigation task, over states of its system.

    Args:
        task: Task with the sets.
        width: Free width of its corridor [m]; None for the task's own.
        world: Walls and obstacles of an episode in place of those, if given.

    Raises:
        TaskError: The width is invalid for the task.
    """

    def __init__(self, task: NavigationTask, width: float | None = None, world: World | None = None) -> None:
        self._names = task.system.build().state_names
        self._positions = position_indices(self._names)
        self._world = task.build_world(width) if world is None else world
        self._radius = task.robot.radius
        self._tilt_limit = math.inf if task.robot.tilt_limit is None else task.robot.tilt_limit
        self._tilt = self._names.index("psi") if "psi" in self._names else None
        self._goal = task.goal.region
        self._trap = None if task.trap is None else task.trap.region
        self._path = None if self._world.path is None else PathCoordinates(self._world.path)

    def clearance(self, states: ArrayLike) -> NDArray[np.float64]:
        """Return the distance (...) from the body's disc to the nearest wall or obstacle [m] at states (..., n)."""
        points = np.asarray(states, dtype=float)[..., self._positions]
        return self._world.signed_distance(points) - self._radius

    def in_goal(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Return whether states (..., n) lie in the goal (...), in path coordinates if the task has a corridor."""
        return self._contains(self._goal, np.asarray(states, dtype=float))

    def outcomes(self, states: ArrayLike) -> NDArray[np.uint8]:
        """Classify states (..., n) into sets (...); collision takes precedence over goal, and goal over trap."""
        states = np.asarray(states, dtype=float)
        out = np.full(states.shape[:-1], Outcome.RUNNING, dtype=np.uint8)
        if self._trap is not None:
            out[self._contains(self._trap, states)] = Outcome.TRAP
        out[self.in_goal(states)] = Outcome.GOAL
        out[self.clearance(states) <= 0.0] = Outcome.COLLISION
        if self._tilt is not None:
            out[np.abs(wrap(states[..., self._tilt])) > self._tilt_limit] = Outcome.COLLISION
        return out

    def _contains(self, region: Region, states: NDArray[np.float64]) -> NDArray[np.bool_]:
        if self._path is None:
            return region.contains(self._names, states)
        poses = states.reshape(-1, len(self._names))[:, :3]  # the state of a corridor's system starts with x, y, theta
        along = np.array([self._path(pose) for pose in poses]).reshape(*states.shape[:-1], 3)
        return region.contains(PATH_NAMES, along)

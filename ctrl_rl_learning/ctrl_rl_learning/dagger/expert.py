"""The expert for a corridor: optimal control by the time to reach on the true map of an episode."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from ctrl_rl_core.navigation import FREE, OCCUPIED
from ctrl_rl_navigation.driving import LookAhead
from ctrl_rl_navigation.robot import DriveLimits, limits_of
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from ctrl_rl_core import ArcPath, NavigationTask, OccupancyMap, Robot, World
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_navigation import MapSolver

Array = NDArray[np.float64]

_MARGIN_TO_POSTS = 0.005
_RESOLUTION = 0.02
_MARGIN = 0.2
_ARRIVED = 0.1
_ANY_SPEED, _ANY_TURN = 2.0, 20.0
"""Accelerations that let a small robot reach any speed within one command period [m/s^2], [rad/s^2]."""
_CREEP, _ALIGNED = 0.06, 0.3
"""Speed in tight places [m/s], and the largest heading error at which the robot drives at that speed [rad]."""
_SPACING = 0.02
"""Spacing of the points on the corridor's centre line [m]."""


def wheeled(task: NavigationTask) -> Robot:
    """Return the robot of a task.

    Raises:
        LearningError: The task has no wheeled robot.
    """
    robot = task.robot.robot
    if robot is None or robot.kind != "differential_drive":
        raise LearningError(f"task '{task.name}' has no wheeled robot")
    return robot


def limits_between_posts(robot: Robot) -> DriveLimits:
    """Return a robot's limits between posts; any speed is reachable within one command period."""
    limits = limits_of(robot, _MARGIN_TO_POSTS)
    return replace(limits, turn_acceleration=_ANY_TURN, acceleration=_ANY_SPEED, radius=robot.through_gaps)


class Expert:
    """Expert driver for one episode, which knows the corridor's walls and partitions and the robot's true pose."""

    def __init__(self, task: NavigationTask, world: World) -> None:
        """Solve the time to reach the end of the corridor.

        Raises:
            LearningError: The task has no corridor.
        """
        if world.path is None or world.width is None:
            raise LearningError(f"task '{task.name}' has no corridor")
        map_ = _map_of(world, world.path, world.width)
        robot = wheeled(task)
        self._limits = limits_between_posts(robot)
        low, high = task.goal.region.intervals["s"]
        x, y, _ = world.path.pose(0.5 * (low + high)).tolist()
        self._value = MapSolver(map_, self._limits).solve((x, y), _ARRIVED)
        rim = np.argwhere((map_.cells == OCCUPIED) & binary_dilation(map_.cells == FREE))
        self._rim = map_.cell_to_world(rim[:, 0], rim[:, 1])
        self._tree = cKDTree(self._rim)
        period = 1.0 / task.lidar.rate
        self._ahead = LookAhead(self._limits, period, period + robot.delay, robot.plan.braking)

    def command(self, pose: Array, motion: Array) -> Array:
        """Return the command (2,) [m/s, rad/s] at a pose (3,) [m, m, rad] and a motion v, omega (2,).

        The command is NaN where the expert knows no way: so close to a post that no node around has a time to reach.
        """
        near = self._rim[self._tree.query_ball_point(pose[:2], self._ahead.reach)] - pose[:2]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        choice = self._ahead.choose(self._value, pose, motion, near @ np.array(((c, -s), (s, c))))
        return choice.command if choice.cost < math.inf else self._creep(pose)

    def _creep(self, pose: Array) -> Array:
        """Return a slow command that turns towards lower time to reach, for when no command keeps the clearance."""
        _, slope = self._value.value_and_gradient(pose[:2])
        error = math.remainder(math.atan2(-slope[1], -slope[0]) - float(pose[2]), 2.0 * math.pi)
        speed = _CREEP if abs(error) < _ALIGNED else 0.0
        return np.array((speed, np.clip(2.0 * error, -self._limits.turn_rate, self._limits.turn_rate)))


def _map_of(world: World, path: ArcPath, width: float) -> OccupancyMap:
    """Return the map of a corridor; everything outside it is occupied, so that no path leads around it."""
    line = path.pose(np.arange(0.0, path.length + _SPACING, _SPACING))[:, :2]
    low, high = line.min(axis=0) - width - _MARGIN, line.max(axis=0) + width + _MARGIN
    columns, rows = np.ceil((high - low) / _RESOLUTION).astype(int)
    empty = OccupancyMap(np.zeros((rows, columns), np.int8), _RESOLUTION, (low[0], low[1], 0.0))
    places = empty.cell_to_world(*np.indices((rows, columns)))
    beside = cKDTree(line).query(places)[0] > 0.5 * width
    inside = ~beside
    cells = np.where(beside, OCCUPIED, FREE).astype(np.int8)
    cells[inside] = np.where(world.signed_distance(places[inside]) < 0.5 * _RESOLUTION, OCCUPIED, FREE)
    return OccupancyMap(cells, _RESOLUTION, empty.origin)

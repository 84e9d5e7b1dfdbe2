"""Drives a robot to goals on a map: value in the background, look-ahead in the foreground, without ROS.

navigator = Navigator(limits, NavigatorOptions())
navigator.set_map(OccupancyMap.load("office.yaml"))
navigator.set_goal(Goal((4.0, 2.0)))
navigator.see(now, pose_of_scan, echoes)
decision = navigator.decide(now, pose, echoes)      # at each control period
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.driving.background import Job, start_job
from ctrl_rl_navigation.driving.look_ahead import LookAhead
from ctrl_rl_navigation.driving.obstacle_layer import ObstacleLayer
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import MapSolver
from ctrl_rl_navigation.values.map_value import MapValue, path_length

Array = NDArray[np.float64]

_INSIDE = 0.6
"""Share of the goal's tolerance at which the value is zero, so that the robot stops well within it."""
_LOOK_PERIOD = 1.0
"""Time between two looks at the path [s]."""
_SOLVE_PERIOD = 2.0
"""Least time between two solves for one goal [s]."""
_PATIENCE = 6.0
"""Time without progress after which all echoes around count as obstacles [s]."""
_PROGRESS = 0.1
"""Least decrease of the time to reach that counts as progress [s]."""
_FADED = 0.7
"""Share of a value's obstacles that must still be there; else it is solved anew."""
_SAME = 0.15
"""Distance up to which two echoes may come from one obstacle, seen with an error of the pose [m]."""


class NavigatorState(IntEnum):
    """State of the navigator; the numbers are those of ctrl_rl_msgs/NavigatorStatus."""

    WAITING = 0
    SOLVING = 1
    DRIVING = 2
    REACHED = 3
    UNREACHABLE = 4
    BLOCKED = 5
    CANCELLED = 6


@dataclass(frozen=True)
class Goal:
    """A place to drive to.

    Attributes:
        position: Position in the map's frame (2,) [m].
        heading: Direction to turn into on arrival [rad]; None for any.
    """

    position: tuple[float, float]
    heading: float | None = None


@dataclass(frozen=True)
class NavigatorOptions:
    """Settings of a navigator.

    Attributes:
        tolerance: Distance from the goal at which it counts as reached [m].
        heading_tolerance: Error of the heading on arrival [rad].
        memory: Time after which an obstacle that nothing sees is forgotten [s].
        period: Time from command to command [s].
        delay: Time from a command to its effect and until the next one [s].
        deceleration: Deceleration of the robot when it brakes [m/s^2].
        inline: Whether values are solved at once instead of in a thread.
    """

    tolerance: float = 0.15
    heading_tolerance: float = 0.2
    memory: float = 10.0
    period: float = 0.1
    delay: float = 0.2
    deceleration: float = 0.5
    inline: bool = False


@dataclass(frozen=True)
class Decision:
    """The answer of one control period.

    Attributes:
        command: Speed [m/s] and turn rate [rad/s] (2,).
        state: State of the navigator.
        message: Reason of the state, in words.
        remaining_time: Time to reach the goal [s]; NaN where it is unknown.
    """

    command: Array
    state: NavigatorState
    message: str
    remaining_time: float = math.nan


class Navigator:
    """Drives one robot to one goal after the other.

    Attributes:
        goal: Goal that is driven to or was reached; None for none.
        value: Time to reach it; None before the first is solved.
        path: Places from the robot to the goal (n, 2) [m].
        layer: Obstacles that the map has not; None before there is a map.
        solves: Number of values that were solved.
    """

    def __init__(self, limits: DriveLimits, options: NavigatorOptions | None = None) -> None:
        self.limits, self.options = limits, options or NavigatorOptions()
        self._ahead = LookAhead(limits, self.options.period, self.options.delay, self.options.deceleration)
        self.goal: Goal | None = None
        self.value: MapValue | None = None
        self.path: Array = np.empty((0, 2))
        self.layer: ObstacleLayer | None = None
        self.solves = 0
        self._solver: MapSolver | None = None
        self._next_goal: Goal | None = None
        self._job: Job[MapValue] | None = None
        self._ended: tuple[NavigatorState, str] | None = None
        self._command = np.zeros(2)
        self._used: Array = np.empty((0, 2))
        self._asked: Array = np.empty((0, 2))
        self._solved_at = self._looked_at = -math.inf
        self._best, self._best_at = math.inf, 0.0
        self._stuck = self._taken = False

    @property
    def command(self) -> Array:
        """The last command (2,), after what the guards left of it."""
        return self._command

    @property
    def solving(self) -> float:
        """Share of the value in work that is done; NaN while none is."""
        return math.nan if self._job is None else self._job.done

    @property
    def remaining_distance(self) -> float:
        """Length of the path from the last look on [m]; NaN where there is none."""
        return path_length(self.path) if len(self.path) else math.nan

    def set_map(self, map_: OccupancyMap) -> None:
        """Use another map; a goal that is driven to is solved anew on it."""
        self._solver = MapSolver(map_, self.limits)
        self.layer = ObstacleLayer(map_, self._solver.clearance, self.options.memory)
        goal = self._next_goal or (self.goal if self._ended is None else None)
        self._forget()
        if goal is not None:
            self.set_goal(goal)

    def set_goal(self, goal: Goal) -> None:
        """Drive to another goal; the robot goes on to the old one until the value of the new one is ready."""
        self._next_goal = goal
        self._solve()

    def cancel(self) -> bool:
        """Give the goal up and return whether there was one."""
        had = self._next_goal is not None or (self.goal is not None and self._ended is None)
        self._forget()
        if had:
            self._ended = (NavigatorState.CANCELLED, "the goal was cancelled")
        return had

    def sent(self, command: Array) -> None:
        """Note what was sent in the end, from which the next command may differ as the accelerations allow."""
        self._command = np.array(command, np.float64)

    def see(self, now: float, pose: Array, points: Array) -> None:
        """Take the echoes of a scan (n, 2) [m] in the robot's frame; its pose then was (3,) [m, m, rad]."""
        if self.layer is not None:
            self.layer.update(now, pose, points, close_to_walls=self._stuck)
            self._stuck = False

    def decide(self, now: float, pose: Array, points: Array) -> Decision:
        """Return what to do now.

        Args:
            now: Steady time [s].
            pose: Pose of the robot in the map's frame (3,) [m, m, rad].
            points: Echoes in the robot's frame as of now (n, 2) [m].
        """
        self._take_value(now, pose)
        if self._solver is None:
            return self._stand(NavigatorState.WAITING, "waiting for a map")
        if self._ended is not None:
            return self._stand(*self._ended)
        if self.goal is None or self.value is None:
            if self._job is not None:
                return self._stand(NavigatorState.SOLVING, f"solving, {100 * self._job.done:.0f} % done")
            return self._stand(NavigatorState.WAITING, "waiting for a goal")
        if self._has_arrived(pose):
            return self._arrive(pose)
        self._look(now, pose)
        left = float(self.value.value(pose[:2]))
        if self._taken:
            return self._stand(NavigatorState.BLOCKED, "an obstacle that the map has not stands on the goal")
        if not math.isfinite(left):
            return self._no_way(pose)
        return self._drive(now, pose, points, left)

    def _drive(self, now: float, pose: Array, points: Array, left: float) -> Decision:
        assert self.value is not None
        choice = self._ahead.choose(self.value, pose, self._command, points)
        if left < self._best - _PROGRESS:
            self._best, self._best_at = left, now
        waited = now - self._best_at
        if waited > _PATIENCE:
            self._stuck = True
            self._best, self._best_at = math.inf, now
            self._solved_at = -math.inf
        if math.isinf(choice.cost):
            return Decision(choice.command, NavigatorState.BLOCKED, "no command is safe by the scan", left)
        return Decision(choice.command, NavigatorState.DRIVING, "driving", choice.cost)

    def _no_way(self, pose: Array) -> Decision:
        """Return the answer where the value at the robot is infinite."""
        assert self._solver is not None
        if len(self._used):
            return self._stand(NavigatorState.BLOCKED, "an obstacle that the map has not blocks every way to the goal")
        rows, columns = self._solver.map.world_to_cell(pose[:2])
        height, width = self._solver.clearance.shape
        where = f"the robot is at ({pose[0]:.2f}, {pose[1]:.2f})"
        if not (0 <= rows < height and 0 <= columns < width):
            return self._stand(NavigatorState.WAITING, f"{where}, off the map: is the pose right?")
        if self._solver.clearance[rows, columns] <= 0.0:
            return self._stand(
                NavigatorState.WAITING, f"{where}, where the map has an obstacle or nothing: is the pose right?"
            )
        self._ended = (NavigatorState.UNREACHABLE, f"no way leads from ({pose[0]:.2f}, {pose[1]:.2f}) to the goal")
        return self._stand(*self._ended)

    def _has_arrived(self, pose: Array) -> bool:
        assert self.goal is not None
        return math.dist(pose[:2], self.goal.position) <= self.options.tolerance

    def _arrive(self, pose: Array) -> Decision:
        """Turn into the goal's heading, or say that it is reached."""
        assert self.goal is not None
        if self.goal.heading is not None:
            error = math.remainder(self.goal.heading - float(pose[2]), 2.0 * math.pi)
            if abs(error) > self.options.heading_tolerance:
                rate = min(self.limits.turn_rate, math.sqrt(2.0 * 0.5 * self.limits.turn_acceleration * abs(error)))
                most = self.limits.turn_acceleration * self.options.period
                turn = math.copysign(min(rate, 2.0 * abs(error)), error)
                command = np.array((0.0, np.clip(turn, self._command[1] - most, self._command[1] + most)))
                left = abs(error) / self.limits.turn_rate
                return Decision(command, NavigatorState.DRIVING, "turning into the heading of the goal", left)
        self._ended = (NavigatorState.REACHED, "the goal is reached")
        self.path = np.empty((0, 2))
        return self._stand(*self._ended)

    def _stand(self, state: NavigatorState, message: str) -> Decision:
        left = 0.0 if state is NavigatorState.REACHED else math.nan
        return Decision(np.zeros(2), state, message, left)

    def _look(self, now: float, pose: Array) -> None:
        """Look at the path, and have the value solved anew where obstacles lie on it, or have gone."""
        if now - self._looked_at < _LOOK_PERIOD:
            return
        self._looked_at = now
        assert self.value is not None
        assert self.layer is not None
        self.path = self.value.path(pose[:2])
        if self._job is not None or now - self._solved_at < _SOLVE_PERIOD:
            return
        points = self.layer.points()
        if self._on_the_way(points) or self._have_gone(points) or self._stuck:
            self._solved_at = now
            self._solve(points)

    def _on_the_way(self, points: Array) -> bool:
        """Return whether an obstacle that the value does not know lies on the path."""
        if not len(points) or not len(self.path):
            return False
        assert self.value is not None
        cell = self.value.map.resolution
        path = self.path[:: max(1, int(self.limits.room / cell))]
        away = _distances(points, path)
        return bool((away < self.limits.room - 1.5 * cell).any())

    def _have_gone(self, points: Array) -> bool:
        """Return whether many of the obstacles that the value knows are not there any more."""
        if not len(self._used) or not len(points):
            return len(self._used) > 0
        return float((_distances(self._used, points) < _SAME).mean()) < _FADED

    def _solve(self, obstacles: Array | None = None) -> None:
        """Begin to solve for the next goal, or anew for the present one."""
        goal = self._next_goal or self.goal
        solver = self._solver
        if self._job is not None:
            self._job.cancel()
            self._job = None
        if goal is None or solver is None:
            return
        if obstacles is None:
            obstacles = np.empty((0, 2))
        self._asked = obstacles
        radius = _INSIDE * self.options.tolerance

        def work(job: Job[MapValue]) -> MapValue:
            def report(share: float) -> None:
                job.done = share

            return solver.solve(goal.position, radius, obstacles, report, lambda: job.wanted)

        self._job = start_job(work, self.options.inline)

    def _take_value(self, now: float, pose: Array) -> None:
        """Take the value that has become ready."""
        job = self._job
        if job is None or not job.finished.is_set():
            return
        self._job = None
        if job.error is not None and not isinstance(job.error, NavigationError):
            raise job.error
        new_goal = self._next_goal is not None
        if new_goal:
            self.goal, self._next_goal, self._ended = self._next_goal, None, None
        self._taken = job.result is None and not new_goal
        if job.result is None:
            if new_goal:
                self._ended = (NavigatorState.UNREACHABLE, str(job.error))
                self.value = None
            else:
                self._used = self._asked
            return
        self.value, self._used = job.result, self._asked
        self.solves += 1
        self._best, self._best_at = math.inf, now
        self._solved_at, self._looked_at = now, -math.inf
        if new_goal:
            self.path = self.value.path(pose[:2])

    def _forget(self) -> None:
        """Drop goal, value and work."""
        if self._job is not None:
            self._job.cancel()
        self._job = self.goal = self._next_goal = self.value = self._ended = None
        self._used, self.path = np.empty((0, 2)), np.empty((0, 2))


def _distances(points: Array, others: Array) -> Array:
    """Return the distance of each point (n, 2) to the nearest of the others (m, 2) (n,) [m]."""
    return np.asarray(cKDTree(others).query(points)[0])

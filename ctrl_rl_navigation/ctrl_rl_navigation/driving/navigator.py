"""Drives a robot to goals on a map: value function in the background, look-ahead in the foreground. No ROS."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.driving.decision import Decision, Goal, NavigatorOptions, NavigatorState
from ctrl_rl_navigation.driving.look_ahead import REVERSING, SPEEDS, TURNS_AFTER, LookAhead
from ctrl_rl_navigation.driving.obstacle_layer import ObstacleLayer
from ctrl_rl_navigation.driving.value_keeper import Change, ValueKeeper
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import longest_time_beside
from ctrl_rl_navigation.values.map_value import MapValue, path_length

Array = NDArray[np.float64]

_INSIDE = 0.6
"""Fraction of the goal tolerance at which the value is zero, so that the robot stops well within the tolerance."""
_LOOK_PERIOD = 1.0
"""Interval between checks of the path [s]."""
_SOLVE_PERIOD = 2.0
"""Minimum interval between solves for one goal [s]."""
_PATIENCE = 6.0
"""Time without progress after which all surrounding echoes count as obstacles [s]."""
_PROGRESS = 0.5
"""Minimum decrease of the time to reach that counts as progress [s]."""
_SLACK = 0.1
"""Distance beyond the tolerance at which a blocked robot counts as arrived [m]."""
_FADED = 0.7
"""Fraction of a value's obstacles that must still be present; otherwise the value is recomputed."""
_SAME = 0.15
"""Maximum distance between two echoes of one obstacle, given the pose error [m]."""
_NO_PATH: Array = np.empty((0, 2))


class Navigator:
    """Drives one robot to consecutive goals.

    Attributes:
        limits: Size and limits of the robot.
        options: Settings of the navigator.
        path: Positions from the robot to the goal (n, 2) [m].
        layer: Unmapped obstacles; None without a map.
    """

    def __init__(self, limits: DriveLimits, options: NavigatorOptions | None = None) -> None:
        self.limits, self.options = limits, options or NavigatorOptions()
        turns, speeds = (TURNS_AFTER, REVERSING) if limits.width else ((0.0,), SPEEDS)
        self._ahead = LookAhead(
            limits,
            self.options.period,
            self.options.delay,
            self.options.deceleration,
            turns_after=turns,
            speeds=speeds,
        )
        self._keeper = ValueKeeper(
            limits, _INSIDE * self.options.tolerance, self.options.tolerance, self.options.inline
        )
        self.path: Array = _NO_PATH
        self.layer: ObstacleLayer | None = None
        self._ended: tuple[NavigatorState, str] | None = None
        self._command = np.zeros(2)
        self._solved_at = self._looked_at = -math.inf
        self._best, self._best_at, self._tries = math.inf, 0.0, 0
        self._stuck = self._taken = False

    @property
    def goal(self) -> Goal | None:
        """Current or last reached goal; None for none."""
        return self._keeper.goal

    @property
    def value(self) -> MapValue | None:
        """Time to reach the goal; None without a goal."""
        return self._keeper.value

    @property
    def solving(self) -> float:
        """Completed fraction of the running solve; NaN if there is none."""
        return self._keeper.done

    @property
    def solves(self) -> int:
        """Number of value functions solved."""
        return self._keeper.solves

    @property
    def remaining_distance(self) -> float:
        """Remaining path length since the last check [m]; NaN without a path."""
        return path_length(self.path) if len(self.path) else math.nan

    def set_map(self, map_: OccupancyMap) -> None:
        """Use another map; until the goal is solved on it, the robot continues with the old map."""
        self._keeper.set_map(map_)

    def set_goal(self, goal: Goal) -> None:
        """Drive to another goal; the robot continues to the old goal until the new value is ready."""
        self._keeper.ask(goal)

    def cancel(self) -> bool:
        """Cancel the goal and return whether there was one."""
        had = self._keeper.is_asked or (self.goal is not None and self._ended is None)
        self._keeper.drop()
        self.path = _NO_PATH
        if had:
            self._ended = (NavigatorState.CANCELLED, "the goal was cancelled")
        return had

    def sent(self, command: Array) -> None:
        """Record the command actually sent; acceleration limits apply relative to this command."""
        self._command = np.array(command, np.float64)

    def poll(self, now: float) -> None:
        """Process finished background work at a steady time [s]; `decide` does this too."""
        change = self._keeper.poll(keep_goal=self._ended is None)
        if change is Change.NOTHING:
            return
        self._best, self._best_at = math.inf, now
        self._solved_at, self._looked_at = now, -math.inf
        self._taken = change is Change.TAKEN
        if change is Change.MAP:
            assert self._keeper.solver is not None
            self.layer = ObstacleLayer(self._keeper.solver.map, self._keeper.solver.clearance, self.options.memory)
            self.poll(now)
        elif change is Change.GOAL:
            self._ended, self._tries = None, 0
        elif change is Change.REFUSED:
            self._ended, self.path = (NavigatorState.UNREACHABLE, self._keeper.reason), _NO_PATH

    def see(self, now: float, pose: Array, points: Array) -> None:
        """Process the echoes of a scan (n, 2) [m] in the robot's frame, taken at a pose (3,) [m, m, rad]."""
        if self.layer is not None:
            self.layer.update(now, pose, points, close_to_walls=self._stuck)
            self._stuck = False

    def decide(self, now: float, pose: Array, points: Array) -> Decision:
        """Return the decision for this period.

        Args:
            now: Steady time [s].
            pose: Pose of the robot in the map frame (3,) [m, m, rad].
            points: Echoes in the robot's current frame (n, 2) [m].
        """
        self.poll(now)
        if self._keeper.solver is None:
            preparing = "preparing the map" if self._keeper.prepares_map else "waiting for a map"
            return _stand(NavigatorState.WAITING, preparing)
        if self._ended is not None:
            return _stand(*self._ended)
        goal, value = self.goal, self.value
        if goal is None or value is None:
            if self._keeper.at_work:
                return _stand(NavigatorState.SOLVING, f"solving, {100 * self._keeper.done:.0f} % done")
            return _stand(NavigatorState.WAITING, "waiting for a goal")
        left = float(value.value(pose[:2]))
        if self._is_there(pose, goal, left):
            return self._arrive(pose, goal)
        self._look(now, pose, value)
        if self._taken:
            return _stand(NavigatorState.BLOCKED, "an unmapped obstacle covers the goal")
        if not math.isfinite(left):
            return self._no_way(pose)
        return self._drive(now, pose, points, left)

    def _drive(self, now: float, pose: Array, points: Array, left: float) -> Decision:
        assert self.value is not None
        choice = self._ahead.choose(self.value, pose, self._command, points)
        if left < self._best - _PROGRESS:
            if math.isfinite(self._best):
                self._tries = 0
            self._best, self._best_at = left, now
        if now - self._best_at > _PATIENCE:
            self._stuck, self._best_at = True, now
            self._tries += 1
        if self._tries > 1:
            message = f"no progress for {self._tries * _PATIENCE:.0f} s: something is in the way"
            return Decision(choice.command, NavigatorState.BLOCKED, message, left)
        return Decision(choice.command, NavigatorState.DRIVING, "driving", choice.cost)

    def _is_there(self, pose: Array, goal: Goal, left: float) -> bool:
        """Return whether the goal position is reached, ignoring the heading.

        A blocked robot that could not get closer counts as arrived slightly farther away.
        """
        near = self.options.tolerance + (_SLACK if self._tries else 0.0)
        return math.dist(pose[:2], goal.position) <= near and left <= longest_time_beside(near, self.limits)

    def _no_way(self, pose: Array) -> Decision:
        """Return the decision if the value at the robot is infinite."""
        assert self._keeper.solver is not None
        if len(self._keeper.known):
            return _stand(NavigatorState.BLOCKED, "an unmapped obstacle blocks every path to the goal")
        solver, where = self._keeper.solver, f"({pose[0]:.2f}, {pose[1]:.2f})"
        row, column = solver.map.world_to_cell(pose[:2])
        height, width = solver.clearance.shape
        if not (0 <= row < height and 0 <= column < width):
            return _stand(NavigatorState.WAITING, f"the robot is at {where}, off the map: is the pose right?")
        if solver.clearance[row, column] <= 0.0:
            what = f"the robot is at {where}, where the map has an obstacle or nothing: is the pose right?"
            return _stand(NavigatorState.WAITING, what)
        self._ended = (NavigatorState.UNREACHABLE, f"no way leads from {where} to the goal")
        return _stand(*self._ended)

    def _arrive(self, pose: Array, goal: Goal) -> Decision:
        """Turn to the goal's heading, or report arrival."""
        if goal.heading is not None:
            error = math.remainder(goal.heading - float(pose[2]), 2.0 * math.pi)
            if abs(error) > self.options.heading_tolerance:
                # A rate from which the robot can stop at the heading with half of its acceleration.
                rate = min(self.limits.turn_rate, math.sqrt(self.limits.turn_acceleration * abs(error)))
                most = self.limits.turn_acceleration * self.options.period
                turn = math.copysign(min(rate, 2.0 * abs(error)), error)
                command = np.array((0.0, np.clip(turn, self._command[1] - most, self._command[1] + most)))
                left = abs(error) / self.limits.turn_rate
                return Decision(command, NavigatorState.DRIVING, "turning into the heading of the goal", left)
        message, away = "the goal is reached", math.dist(pose[:2], goal.position)
        if away > self.options.tolerance:
            message = f"reached to {away:.2f} m: obstacles let the robot come no nearer"
        self._ended = (NavigatorState.REACHED, message)
        self.path = _NO_PATH
        return _stand(*self._ended)

    def _look(self, now: float, pose: Array, value: MapValue) -> None:
        """Check the path, and request a new value if obstacles lie on it or have disappeared."""
        if now - self._looked_at < _LOOK_PERIOD:
            return
        self._looked_at = now
        assert self.layer is not None
        self.path = value.path(pose[:2])
        if self._keeper.at_work or now - self._solved_at < _SOLVE_PERIOD:
            return
        points = self.layer.points()
        if self._on_the_way(points, value.map.resolution) or self._have_gone(points):
            self._solved_at = now
            self._keeper.renew(points)

    def _on_the_way(self, points: Array, cell: float) -> bool:
        """Return whether an obstacle unknown to the value lies on the path."""
        if not len(points) or not len(self.path):
            return False
        away = _distances(points, self.path[:: max(1, int(self.limits.room / cell))])
        return bool((away < self.limits.room - 1.5 * cell).any())

    def _have_gone(self, points: Array) -> bool:
        """Return whether many obstacles known to the value have disappeared."""
        known = self._keeper.known
        if not len(known) or not len(points):
            return len(known) > 0
        return float((_distances(known, points) < _SAME).mean()) < _FADED


def warm_up(limits: DriveLimits) -> None:
    """Compile the driving functions, or load them from disk, before timing matters."""
    navigator = Navigator(limits, NavigatorOptions(inline=True))
    navigator.set_map(OccupancyMap(np.zeros((30, 60), np.int8), limits.room))
    navigator.set_goal(Goal((45.0 * limits.room, 15.0 * limits.room)))
    for now in (0.0, 1.5):
        navigator.decide(now, np.array((10.0 * limits.room, 15.0 * limits.room, 0.0)), np.ones((1, 2)))


def _stand(state: NavigatorState, message: str) -> Decision:
    left = 0.0 if state is NavigatorState.REACHED else math.nan
    return Decision(np.zeros(2), state, message, left)


def _distances(points: Array, others: Array) -> Array:
    """Return the distance from each point (n, 2) to the nearest of the others (m, 2) (n,) [m]."""
    return np.asarray(cKDTree(others).query(points)[0])

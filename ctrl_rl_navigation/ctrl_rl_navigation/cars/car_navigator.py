"""Drives a car to goal poses on a map: value function in the background, look-ahead in the foreground. No ROS."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.cars.car_keeper import keep_car_value
from ctrl_rl_navigation.cars.car_limits import CarLimits
from ctrl_rl_navigation.cars.car_value import CarValue
from ctrl_rl_navigation.cars.footprint import distances
from ctrl_rl_navigation.cars.look_ahead import CarLookAhead
from ctrl_rl_navigation.driving.decision import Decision, Goal, NavigatorOptions, NavigatorState
from ctrl_rl_navigation.driving.obstacle_layer import ObstacleLayer
from ctrl_rl_navigation.driving.value_keeper import Change
from ctrl_rl_navigation.values.map_value import path_length

Array = NDArray[np.float64]

_LOOK_PERIOD, _SOLVE_PERIOD = 1.0, 2.0
"""Minimum intervals between checks of the path, and between solves for one goal [s]."""
_PATIENCE, _PROGRESS = 6.0, 0.5
"""Time without progress after which the car counts as stuck [s], and the decrease of the time that is progress [s]."""
_STOPPED = 0.1
"""Fraction of the full speed below which a car at the goal counts as arrived."""
_NO_PATH: Array = np.empty((0, 2))
_NOBODY: Array = np.empty((0, 12))


class CarNavigator:
    """Drives one car to consecutive goals, with the methods of `Navigator`.

    Attributes:
        limits: Size and limits of the car.
        options: Settings of the navigator.
        path: Positions from the car to the goal (n, 2) [m].
        layer: Unmapped obstacles; None without a map.
        detour: Time that unmapped obstacles have added to the way [s].
    """

    def __init__(self, limits: CarLimits, options: NavigatorOptions | None = None) -> None:
        self.limits, self.options = limits, options or NavigatorOptions()
        self._ahead = CarLookAhead(limits, self.options.period, max(self.options.delay - self.options.period, 0.0))
        self._pose: Array | None = None
        self._keeper = keep_car_value(limits, self.options, lambda: self._pose)
        self.path: Array = _NO_PATH
        self.layer: ObstacleLayer | None = None
        self.detour = 0.0
        self._field = np.empty((0, 0), np.float32)
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
    def value(self) -> CarValue | None:
        """Time to reach the goal; None without a goal."""
        return self._keeper.value

    @property
    def is_asked(self) -> bool:
        """Whether a goal is still without a value."""
        return self._keeper.is_asked

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
        """Use another map; until the goal is solved on it, the car continues with the old map."""
        self._keeper.set_map(map_)

    def set_goal(self, goal: Goal) -> None:
        """Drive to another goal; the car continues to the old goal until the new value is ready."""
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

    def stand_at(self, pose: Array) -> None:
        """Note that the car stands at a pose (3,) [m, m, rad] with straight wheels."""
        self._pose = np.array(pose, np.float64)
        self._command = np.zeros(2)
        self._ahead.forget(stands=True)

    def poll(self, now: float) -> None:
        """Process finished background work at a steady time [s]; `decide` does this too."""
        news = self._keeper.poll(keep_goal=self._ended is None)
        if news is Change.NOTHING:
            return
        self._best, self._best_at = math.inf, now
        self._solved_at, self._looked_at = now, -math.inf
        self._taken = news is Change.TAKEN
        if news is Change.MAP:
            assert self._keeper.solver is not None
            map_, clearance = self._keeper.solver.map, self._keeper.solver.clearance
            self.layer = ObstacleLayer(map_, clearance, self.options.memory)
            self._field = distances(clearance, map_.resolution)
            self.poll(now)
        elif news is Change.GOAL:
            self._ended, self._tries = None, 0
            self._ahead.forget()
        elif news is Change.REFUSED:
            self._ended, self.path = (NavigatorState.UNREACHABLE, self._keeper.reason), _NO_PATH

    def see(self, now: float, pose: Array, points: Array, empty: Array = _NO_PATH) -> None:  # noqa: ARG002 - as Navigator
        """Process the echoes of a scan (n, 2) [m] in the robot's frame, taken at a pose (3,) [m, m, rad]."""
        if self.layer is not None:
            self.layer.update(now, pose, points, close_to_walls=self._stuck)
            self._stuck = False

    def decide(self, now: float, pose: Array, points: Array, movers: Array = _NOBODY) -> Decision:
        """Return the decision for this period.

        Args:
            now: Steady time [s].
            pose: Pose of the rear axle's middle in the map frame (3,) [m, m, rad].
            points: Echoes in the robot's current frame (n, 2) [m].
            movers: Positions of movers in the map frame, in the first two of their columns (m, 12) [m]: they count as
                standing obstacles.
        """
        self._pose = np.array(pose, np.float64)
        self.poll(now)
        self._ahead.sent(self._command)
        if self._keeper.solver is None:
            preparing = "preparing the map" if self._keeper.prepares_map else "waiting for a map"
            return self._stand(NavigatorState.WAITING, preparing)
        if self._ended is not None:
            return self._stand(*self._ended)
        goal, value = self.goal, self.value
        if goal is None or value is None:
            if self._keeper.at_work:
                return self._stand(NavigatorState.SOLVING, f"solving, {100 * self._keeper.done:.0f} % done")
            return self._stand(NavigatorState.WAITING, "waiting for a goal")
        if self._is_there(pose, goal):
            self._ended, self.path = (NavigatorState.REACHED, "the goal is reached"), _NO_PATH
            return self._stand(*self._ended)
        self._look(now, pose, value)
        if self._taken:
            return self._stand(NavigatorState.BLOCKED, "an unmapped obstacle covers the goal")
        left = value.time_near(pose)
        if not math.isfinite(left):
            if not value.complete and not self._keeper.at_work:
                self._keeper.renew(self._keeper.known)
            return self._no_way(pose) if value.complete else self._stand(NavigatorState.SOLVING, "solving farther")
        return self._drive(now, pose, np.concatenate((points, _seen_from(pose, movers))), left, value)

    def _drive(self, now: float, pose: Array, points: Array, left: float, value: CarValue) -> Decision:
        solver = self._keeper.solver
        assert solver is not None
        first = solver.map.cell_to_world(0, 0).tolist()
        place = (first[0], first[1], solver.map.origin[2], solver.map.resolution)
        command, cost = self._ahead.choose(value, self._field, place, pose, self._command, points)
        if left < self._best - _PROGRESS:
            self._best, self._best_at, self._tries = left, now, 0
        if now - self._best_at > _PATIENCE:
            self._stuck, self._best_at = True, now
            self._tries += 1
        if self._tries > 1 or not math.isfinite(cost):
            message = "no command is free of obstacles" if not math.isfinite(cost) else "no progress"
            return Decision(command, NavigatorState.BLOCKED, f"{message}: something is in the way", left)
        return Decision(command, NavigatorState.DRIVING, "driving", cost)

    def _is_there(self, pose: Array, goal: Goal) -> bool:
        """Return whether the car is at the goal, and will be when it has stopped."""
        v = float(self._command[0])
        if abs(v) > _STOPPED * self.limits.speed:
            return False
        way = 0.5 * v * abs(v) / self.limits.braking
        rest = pose[:2] + way * np.array((math.cos(pose[2]), math.sin(pose[2])))
        if max(math.dist(pose[:2], goal.position), math.dist(rest, goal.position)) > self.options.tolerance:
            return False
        if goal.heading is None:
            return True
        return abs(math.remainder(goal.heading - float(pose[2]), 2.0 * math.pi)) <= self.options.heading_tolerance

    def _no_way(self, pose: Array) -> Decision:
        """Return the decision where the value has no time."""
        assert self._keeper.solver is not None
        if len(self._keeper.known):
            return self._stand(NavigatorState.BLOCKED, "an unmapped obstacle blocks every path to the goal")
        solver, where = self._keeper.solver, f"({pose[0]:.2f}, {pose[1]:.2f})"
        if int(solver.map.at(pose[:2])) != 0:
            what = f"the robot is at {where}, off the map or where it has an obstacle or nothing: is the pose right?"
            return self._stand(NavigatorState.WAITING, what)
        self._ended = (NavigatorState.UNREACHABLE, f"no way for a car leads from {where} to the goal")
        return self._stand(*self._ended)

    def _look(self, now: float, pose: Array, value: CarValue) -> None:
        """Check the path, and request a new value if obstacles lie on it or have disappeared."""
        if now - self._looked_at < _LOOK_PERIOD:
            return
        self._looked_at = now
        assert self.layer is not None
        self.path = value.path(pose)
        if self._keeper.at_work or now - self._solved_at < _SOLVE_PERIOD:
            return
        points, known = self.layer.points(), self._keeper.known
        away = _distances(points, self.path) < self.limits.room - value.map.resolution
        gone = len(known) > 0 and (len(points) == 0 or float((_distances(known, points) < 0.15).mean()) < 0.7)
        if gone or bool((away & (_distances(points, known) > value.map.resolution)).any()):
            self._solved_at = now
            self._keeper.renew(points)

    def _stand(self, state: NavigatorState, message: str) -> Decision:
        """Return the decision to brake to a stop."""
        left = 0.0 if state is NavigatorState.REACHED else math.nan
        return Decision(self._ahead.slowed(float(self._command[0])), state, message, left)


def _seen_from(pose: Array, movers: Array) -> Array:
    """Return the positions of movers (m, 12) in the frame of a pose (m, 2) [m]."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray((movers[:, :2] - pose[:2]) @ np.array(((c, -s), (s, c))))


def _distances(points: Array, others: Array) -> Array:
    """Return the distance from each point (n, 2) to the nearest of the others (m, 2) (n,) [m]; inf without others."""
    from scipy.spatial import cKDTree

    if not len(points) or not len(others):
        return np.full(len(points), np.inf)
    return np.asarray(cKDTree(others).query(points)[0])


def warm_up_car(limits: CarLimits) -> None:
    """Compile the driving functions, or load them from disk, before timing matters."""
    navigator, side = CarNavigator(limits, NavigatorOptions(inline=True)), 3.0 * limits.radius
    navigator.set_map(OccupancyMap(np.zeros((60, 60), np.int8), side / 30.0))
    navigator.set_goal(Goal((side, side)))
    for now in (0.0, 1.5):
        navigator.decide(now, np.array((0.8 * side, side, 0.0)), np.full((1, 2), side))

"""Controllers of the benchmark by name, and the safety filter below them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from ctrl_rl_navigation.driving.decision import Goal, NavigatorOptions
from ctrl_rl_navigation.driving.explorer import Explorer, ExplorerOptions
from ctrl_rl_navigation.driving.navigator import Navigator
from ctrl_rl_navigation.driving.scan_map import ScanMap
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import MapSolver
from ctrl_rl_safety.filter.safety_filter import SafetyFilter
from ctrl_rl_safety.filter.verdict import FilterOptions, Reading
from ctrl_rl_safety.models.robot_model import find_model
from numpy.typing import NDArray
from sim_bridge.simulation.occupancy import draw_map

from ctrl_rl_core import find_robot
from ctrl_rl_trials.barn.drive import LIDAR_X, PERIOD, Controller, Sensed
from ctrl_rl_trials.barn.dynamic_window import DynamicWindow
from ctrl_rl_trials.barn.policy_driver import PolicyDriver
from ctrl_rl_trials.barn.scenarios import Scenario

Array = NDArray[np.float64]

_JACKAL = find_robot("jackal")
JACKAL = DriveLimits(
    speed=1.5,
    turn_rate=3.0,
    acceleration=5.0,
    turn_acceleration=15.0,
    radius=_JACKAL.radius,
    margin=0.03,
    length=_JACKAL.length,
    width=_JACKAL.width,
)
"""A Jackal, a little below its limits."""
FILTERED_JACKAL = replace(JACKAL, margin=0.07)
"""A Jackal above the safety filter, which keeps farther away from what it cannot see exactly."""
DELAY = 0.1
"""Time from a command to its effect and until the next one [s]."""
DECELERATION = _JACKAL.braking
"""Deceleration with which the robot brakes [m/s^2]."""
TOLERANCE = 0.3
"""Distance from the goal at which controllers stop [m], well within the benchmark's."""
REACH = 8.0
"""Distance up to which echoes go on a map [m]."""
_MAP_MARGIN, _RESOLUTION = 3.0, 0.05
_PLAN_PERIOD = 0.5
_SET_PERIOD = 0.1
_CARROT = 1.0
"""Distance of the place on the path that the dynamic window steers for [m]."""


class ExplorerDriver:
    """The navigator without a map."""

    def __init__(self, scenario: Scenario, limits: DriveLimits) -> None:
        options = ExplorerOptions(tolerance=TOLERANCE, period=PERIOD, delay=DELAY, deceleration=DECELERATION)
        self._explorer = Explorer(limits, np.array(scenario.start), scenario.goal, options)

    def decide(self, sensed: Sensed) -> Array:  # noqa: D102 - see Controller
        self._explorer.see(sensed.now, *_placed(sensed))
        return self._explorer.decide(sensed.now, sensed.pose)

    def sent(self, command: Array) -> None:  # noqa: D102
        self._explorer.sent(command)


class NavigatorDriver:
    """The navigator with a map of the world, on which it is where odometry says."""

    def __init__(self, scenario: Scenario, limits: DriveLimits) -> None:
        options = NavigatorOptions(
            tolerance=TOLERANCE, period=PERIOD, delay=DELAY, deceleration=DECELERATION, inline=True
        )
        self._navigator = Navigator(limits, options)
        self._navigator.set_map(draw_map(scenario.task, scenario.task.build_world()))
        self._navigator.set_goal(Goal(scenario.goal))

    def decide(self, sensed: Sensed) -> Array:  # noqa: D102
        near = sensed.points[np.hypot(*sensed.points.T) < REACH]
        self._navigator.see(sensed.now, sensed.pose, near)
        return self._navigator.decide(sensed.now, sensed.pose, near).command

    def sent(self, command: Array) -> None:  # noqa: D102
        self._navigator.sent(command)


class DynamicWindowDriver:
    """The dynamic window as move_base uses it: it follows the shortest path on what has been seen."""

    def __init__(self, scenario: Scenario, limits: DriveLimits) -> None:
        self._window, self._limits, self._goal = DynamicWindow(limits), limits, np.array(scenario.goal)
        self._map = ScanMap(np.array((scenario.start[:2], scenario.goal)), _MAP_MARGIN, _RESOLUTION)
        self._path = np.array((scenario.start[:2], scenario.goal))
        self._planned_at = -math.inf

    def decide(self, sensed: Sensed) -> Array:  # noqa: D102
        self._map.see(*_placed(sensed))
        if sensed.now - self._planned_at >= _PLAN_PERIOD:
            self._planned_at = sensed.now
            self._plan(sensed.pose)
        x, y, theta = sensed.pose
        nearest = int(np.argmin(np.hypot(*(self._path - (x, y)).T)))
        rest = self._path[nearest:]
        ahead = rest[np.hypot(*(rest - (x, y)).T) >= _CARROT]
        dx, dy = (ahead[0] if len(ahead) else self._goal) - (x, y)
        c, s = math.cos(theta), math.sin(theta)
        return self._window.choose(np.array((c * dx + s * dy, c * dy - s * dx)), sensed.motion, sensed.points)

    def _plan(self, pose: Array) -> None:
        """Plan the path anew; where there is none, the old one stays."""
        solver = MapSolver(self._map.occupancy(), self._limits, unknown_is_free=True)
        try:
            value = solver.solve((float(self._goal[0]), float(self._goal[1])), TOLERANCE, widest=2.0 * TOLERANCE)
        except NavigationError:
            return
        path = value.path(pose[:2])
        if len(path) > 1:
            self._path = path

    def sent(self, command: Array) -> None:
        """Do nothing: the window is around the measured motion."""


def _placed(sensed: Sensed) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the lidar's place (2,) and the ends of its beams (n, 2) in odometry's frame [m], and which have echoes."""
    x, y, theta = sensed.pose
    c, s = math.cos(theta), math.sin(theta)
    beams = sensed.ends - (LIDAR_X, 0.0)
    ranges = np.hypot(*beams.T)
    ends = (LIDAR_X, 0.0) + beams * np.minimum(1.0, REACH / np.maximum(ranges, 1e-6))[:, None]
    placed = np.column_stack((x + c * ends[:, 0] - s * ends[:, 1], y + s * ends[:, 0] + c * ends[:, 1]))
    return np.array((x + c * LIDAR_X, y + s * LIDAR_X)), placed, sensed.echoes & (ranges < REACH)


class SafetyCheck:
    """The safety filter with the Jackal's model, whose set is solved ten times a second; a `Filter`."""

    def __init__(self, mover_speed: float) -> None:
        self._solved_at = -math.inf
        self._filter = SafetyFilter(find_model("jackal"), FilterOptions(period=PERIOD, mover_speed=mover_speed))

    def __call__(self, sensed: Sensed, command: Array) -> Array:
        """Return the certified command nearest to a raw one (2,)."""
        self._filter.see(sensed.now, sensed.pose, sensed.points)
        if sensed.now - self._solved_at >= _SET_PERIOD - 1e-6:
            self._solved_at = sensed.now
            self._filter.use(self._filter.solve())
        reading = Reading(sensed.pose, float(sensed.motion[0]), float(sensed.motion[1]))
        verdict = self._filter.decide(sensed.now, reading, command)
        self._filter.sent(sensed.now, verdict.command)
        return verdict.command


CONTROLLERS: Mapping[str, Callable[[Scenario, DriveLimits], Controller]] = {
    "explorer": ExplorerDriver,
    "navigator": NavigatorDriver,
    "dynamic_window": DynamicWindowDriver,
    **{name: partial(PolicyDriver, name) for name in ("curved_corridor", "car_ttr", "car_navigation")},
}
"""Makers of controllers by name; the last three are policies of the suite."""

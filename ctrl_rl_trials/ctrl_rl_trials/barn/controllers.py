"""Controllers for the benchmark by name, including policies, and the safety filter that may follow them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from ctrl_rl_core.sensing import echoes, measured, planar
from ctrl_rl_navigation.driving import (
    Explorer,
    ExplorerOptions,
    Goal,
    Navigator,
    NavigatorDriver,
    NavigatorOptions,
    ScanMap,
)
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_safety.filter import SensorFilter
from numpy.typing import NDArray
from sim_bridge.simulation import draw_map

from ctrl_rl_core import (
    Driver,
    PolicyDriver,
    Sensors,
    find_policy,
    find_robot,
    load_navigation_task,
    load_policy,
    make_odometry,
)
from ctrl_rl_navigation import MapSolver
from ctrl_rl_safety import FilterOptions, SafetyFilter, find_model
from ctrl_rl_trials.barn.drive import LIDAR_X, PERIOD
from ctrl_rl_trials.barn.dynamic_window import DynamicWindow
from ctrl_rl_trials.barn.scenarios import Scenario

Array = NDArray[np.float64]


class TransplantedPolicy:
    """Unchanged policy from another task; a transform puts that task's goal at the benchmark's goal.

    A policy that observes no pose drives by its lidar alone.
    """

    def __init__(self, name: str, scenario: Scenario, _: DriveLimits) -> None:
        self._policy = load_policy(find_policy(name))
        task = load_navigation_task(name)
        self._driver, self._decided_at = PolicyDriver(self._policy), -math.inf
        self._goal: Array | None = None
        self._turn, self._shift = 0.0, np.zeros(2)
        if "pose" in self._policy.needs or "goal" in self._policy.needs:
            (x, y), (start_x, start_y) = task.goal.region.position, task.start.region.position
            here = math.atan2(scenario.goal[1] - scenario.start[1], scenario.goal[0] - scenario.start[0])
            self._turn = math.atan2(y - start_y, x - start_x) - here
            self._shift = np.array((x, y)) - _turned(np.array(scenario.goal), self._turn)
            self._goal = np.array((x, y, 0.0))

    def command(self, sensors: Sensors) -> Array:  # noqa: D102 - see Driver
        policy, period = self._policy, self._policy.period
        if period is not None and sensors.time - self._decided_at < period - 1e-6:
            return sensors.command
        self._decided_at = sensors.time
        x, y, theta = planar(sensors.odometry[:7].tolist())
        place = _turned(np.array((x, y)), self._turn) + self._shift
        v, omega = sensors.speeds
        odometry = make_odometry(np.array((*place, theta + self._turn)), np.array((v, 0.0, omega)))
        goal = self._goal if "goal" in policy.needs else None
        return self._driver.command(sensors._replace(odometry=odometry, pose=planar(odometry[:7].tolist()), goal=goal))


def _turned(place: Array, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array((c * place[0] - s * place[1], s * place[0] + c * place[1]))


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
"""Limits of a Jackal, slightly reduced."""
FILTERED_JACKAL = replace(JACKAL, margin=0.07)
"""Limits of a Jackal with the safety filter, which needs a larger margin to uncertain obstacles."""
DELAY = 0.1
"""Time from a command to its effect, plus the time until the next command [s]."""
DECELERATION = _JACKAL.braking
"""Deceleration with which the robot brakes [m/s^2]."""
TOLERANCE = 0.3
"""Distance from the goal at which controllers stop [m], well within the benchmark's tolerance."""
REACH = 8.0
"""Maximum range of echoes that are added to the map [m]."""
_MAP_MARGIN, _RESOLUTION = 3.0, 0.05
_PLAN_PERIOD = 0.5
_SET_PERIOD = 0.1
_CARROT = 1.0
"""Distance along the path to the point that the dynamic window steers for [m]."""


class ExplorerDriver:
    """Driver that navigates without a map."""

    def __init__(self, scenario: Scenario, limits: DriveLimits) -> None:
        options = ExplorerOptions(tolerance=TOLERANCE, period=PERIOD, delay=DELAY, deceleration=DECELERATION)
        self._explorer = Explorer(limits, np.array(scenario.start), scenario.goal, options)

    def command(self, sensors: Sensors) -> Array:  # noqa: D102 - see Driver
        assert sensors.pose is not None, "odometry is the pose"
        self._explorer.sent(sensors.command)
        self._explorer.see(sensors.time, *_placed(sensors), heading=float(sensors.pose[2]))
        return self._explorer.decide(sensors.time, sensors.pose)


def navigator_driver(scenario: Scenario, limits: DriveLimits) -> NavigatorDriver:
    """Return the navigator with a map of the world, localised by odometry."""
    options = NavigatorOptions(tolerance=TOLERANCE, period=PERIOD, delay=DELAY, deceleration=DECELERATION, inline=True)
    navigator = Navigator(limits, options)
    navigator.set_map(draw_map(scenario.task, scenario.task.build_world()))
    navigator.set_goal(Goal(scenario.goal))
    return NavigatorDriver(navigator, LIDAR_X, REACH)


class DynamicWindowDriver:
    """Dynamic-window driver that, as in move_base, follows the shortest path on the map built so far."""

    def __init__(self, scenario: Scenario, limits: DriveLimits) -> None:
        self._window, self._limits, self._goal = DynamicWindow(limits), limits, np.array(scenario.goal)
        self._map = ScanMap(np.array((scenario.start[:2], scenario.goal)), _MAP_MARGIN, _RESOLUTION)
        self._path = np.array((scenario.start[:2], scenario.goal))
        self._planned_at = -math.inf

    def command(self, sensors: Sensors) -> Array:  # noqa: D102 - see Driver
        assert sensors.pose is not None, "odometry is the pose"
        self._map.see(*_placed(sensors))
        if sensors.time - self._planned_at >= _PLAN_PERIOD:
            self._planned_at = sensors.time
            self._plan(sensors.pose)
        x, y, theta = sensors.pose
        nearest = int(np.argmin(np.hypot(*(self._path - (x, y)).T)))
        rest = self._path[nearest:]
        ahead = rest[np.hypot(*(rest - (x, y)).T) >= _CARROT]
        dx, dy = (ahead[0] if len(ahead) else self._goal) - (x, y)
        c, s = math.cos(theta), math.sin(theta)
        points = echoes(sensors.ranges, sensors.scan, math.inf, LIDAR_X)
        return self._window.choose(np.array((c * dx + s * dy, c * dy - s * dx)), np.array(sensors.speeds), points)

    def _plan(self, pose: Array) -> None:
        """Replan the path; keep the old one if there is none."""
        solver = MapSolver(self._map.occupancy(), self._limits, unknown_is_free=True)
        try:
            value = solver.solve((float(self._goal[0]), float(self._goal[1])), TOLERANCE, widest=2.0 * TOLERANCE)
        except NavigationError:
            return
        path = value.path(pose[:2])
        if len(path) > 1:
            self._path = path


def _placed(sensors: Sensors) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return lidar position (2,) and beam end points (n, 2) in the odometry frame [m], and which beams have echoes."""
    assert sensors.pose is not None, "odometry is the pose"
    x, y, theta = sensors.pose
    c, s = math.cos(theta), math.sin(theta)
    ranges, scan = measured(sensors.ranges, sensors.scan), sensors.scan
    bearings = scan.angle_min + scan.angle_increment * np.arange(scan.beams)
    reached = np.minimum(np.nan_to_num(ranges, nan=0.0), min(REACH, scan.range_max))
    ahead, aside = LIDAR_X + reached * np.cos(bearings), reached * np.sin(bearings)
    placed = np.column_stack((x + c * ahead - s * aside, y + s * ahead + c * aside))
    return np.array((x + c * LIDAR_X, y + s * LIDAR_X)), placed, ranges < REACH


def safety_check(mover_speed: float) -> SensorFilter:
    """Return the safety filter for the Jackal, which recomputes its safe set ten times a second."""
    options = FilterOptions(period=PERIOD, mover_speed=mover_speed)
    return SensorFilter(SafetyFilter(find_model("jackal"), options), LIDAR_X, _SET_PERIOD)


CONTROLLERS: Mapping[str, Callable[[Scenario, DriveLimits], Driver[Sensors]]] = {
    "explorer": ExplorerDriver,
    "navigator": navigator_driver,
    "dynamic_window": DynamicWindowDriver,
    **{name: partial(TransplantedPolicy, name) for name in ("curved_corridor", "car_ttr", "car_navigation")},
}
"""Factories of controllers by name; the last three are policies of the suite."""

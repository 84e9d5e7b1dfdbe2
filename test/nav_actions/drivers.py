"""What follows a path: the navigator, lidar drivers that see the path as a corridor, and a dynamic window."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol

import numpy as np
from ctrl_rl_core.driving import PathDriver
from ctrl_rl_core.sensing import echoes
from ctrl_rl_navigation.driving import Journey, Navigator, NavigatorDriver, NavigatorOptions, legs_along
from ctrl_rl_navigation.robot import limits_of
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap, PolicyDriver, Sensors, find_policy, find_robot, load_policy
from ctrl_rl_trials import DynamicWindow, DynamicWindowOptions
from nav_actions.paths import ROBOT, PathTrial

Array = NDArray[np.float64]

PERIOD = 0.1
"""Time from command to command [s]."""
TOLERANCE = 0.15
_ROBOT = find_robot(ROBOT)
_PATIENCE = 20.0
_CARROT = 0.4
"""Distance along the path to the place that the dynamic window steers for [m]."""


class PathFollower(Protocol):
    """A driver along a path.

    Attributes:
        arrived: Whether the end is reached.
        failed: Whether it has given up.
    """

    arrived: bool
    failed: bool

    def command(self, sensors: Sensors, /) -> Array:
        """Return the command (2,)."""


class NavigatorFollower:
    """The navigator on the value of the corridor around the path."""

    def __init__(self, trial: PathTrial) -> None:
        limits = limits_of(_ROBOT)
        options = NavigatorOptions(tolerance=TOLERANCE, period=PERIOD, inline=True)
        navigator = Navigator(limits, options)
        navigator.set_map(OccupancyMap.load(trial.map_file))
        legs = legs_along(trial.path, None, options.corridor, None)
        self._journey = Journey(navigator, legs, limits.speed, _PATIENCE, stops=False)
        self._driver = NavigatorDriver(navigator, _ROBOT.lidar.x)
        self.arrived = self.failed = False

    def command(self, sensors: Sensors) -> Array:
        command = self._driver.command(sensors)
        self._journey.update(sensors.time, self._driver.decision, sensors.pose)
        self.arrived, self.failed = self._journey.arrived, self._journey.failure is not None
        return command


class CorridorFollower:
    """A lidar policy that sees the path as a corridor; it decides at each scan."""

    failed = False

    def __init__(self, policy: str, trial: PathTrial) -> None:
        driver = PolicyDriver(load_policy(find_policy(policy)))
        self._path = PathDriver(driver, trial.path, 0.35, TOLERANCE, 1.0, 0.5, _ROBOT.lidar.x)
        self._command = np.zeros(2)

    @property
    def arrived(self) -> bool:
        """Whether the end is reached."""
        return self._path.arrived

    def command(self, sensors: Sensors) -> Array:
        if sensors.age == 0.0:
            self._command = self._path.command(sensors)
        return np.zeros(2) if self.arrived else self._command


class DynamicWindowFollower:
    """The dynamic window approach towards a place ahead on the path."""

    failed = False

    def __init__(self, trial: PathTrial) -> None:
        options = DynamicWindowOptions(reach=1.5, period=PERIOD, delay=0.2, deceleration=_ROBOT.plan.braking)
        self._window, self._path, self._place = DynamicWindow(limits_of(_ROBOT), options), trial.path, 0
        self.arrived = False

    def command(self, sensors: Sensors) -> Array:
        assert sensors.pose is not None, "a localised robot"
        x, y, theta = sensors.pose.tolist()
        self.arrived |= math.dist((x, y), self._path[-1]) <= TOLERANCE
        if self.arrived:
            return np.zeros(2)
        near = self._path[self._place : self._place + 40]  # forward only, as a controller prunes a path
        self._place += int(np.argmin(np.hypot(*(near - (x, y)).T)))
        rest = self._path[self._place :]
        ahead = rest[np.hypot(*(rest - (x, y)).T) >= _CARROT]
        dx, dy = (ahead[0] if len(ahead) else self._path[-1]) - (x, y)
        c, s = math.cos(theta), math.sin(theta)
        points = echoes(sensors.ranges, sensors.scan, math.inf, _ROBOT.lidar.x)
        return self._window.choose(np.array((c * dx + s * dy, c * dy - s * dx)), np.array(sensors.speeds), points)


DRIVERS: Mapping[str, Callable[[PathTrial], Any]] = {
    "navigator": NavigatorFollower,
    "Koopman controller": partial(CorridorFollower, "curved_corridor"),
    "policy": partial(CorridorFollower, "corridor_doorways"),
    "dynamic window": DynamicWindowFollower,
}

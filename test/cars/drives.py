"""A simulated car with the navigator drives to goals with a heading."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_navigation.cars import CarNavigator, CarSolver, car_limits_of
from ctrl_rl_navigation.cli import task_content
from ctrl_rl_navigation.driving import Goal, NavigatorDriver, NavigatorOptions, NavigatorState
from ctrl_rl_safety.filter import SensorFilter
from numpy.typing import NDArray

from cars.maps import Place
from ctrl_rl_core import NavigationTask, Sensors, drive, find_robot
from ctrl_rl_safety import FilterOptions, find_vehicle, make_filter
from sim_bridge import SimulatedRobot, SimulatedWorld, SimulationOptions

Array = NDArray[np.float64]

_SPARE, _LONGEST = 30.0, 3.0
"""Time limit of a drive: additional time [s], and multiple of the optimal one."""
_ENDED = (NavigatorState.REACHED, NavigatorState.UNREACHABLE)
_STOOD = 0.02
"""Speed below which a car stands [m/s]."""
_GAP = 0.05
"""Room around a start beyond the margin [m]."""
_IN_BAY = 0.7
"""Share of the goals that lie in a bay, where there are any."""


class Trial(NamedTuple):
    """A drive from pose to pose (3,) [m, m, rad]."""

    start: Array
    goal: Array


class Ride(NamedTuple):
    """The result of a drive.

    Attributes:
        state: State of the navigator at the end.
        contact: Whether the car touched something.
        seconds: Simulated duration until the car stood at the goal [s].
        optimal: Time to reach from the start, by the value, with speeding up there and stopping at the goal [s]; inf
            without a way.
        solve_seconds: Duration of the solve [s].
        missed: Distance from the goal [m] and difference of the heading [rad] at the end.
    """

    state: NavigatorState
    contact: bool
    seconds: float
    optimal: float
    solve_seconds: float
    missed: tuple[float, float]

    @property
    def arrived(self) -> bool:
        """Whether the car stands at the goal and touched nothing."""
        return self.state is NavigatorState.REACHED and not self.contact


def make_options() -> NavigatorOptions:
    """Return the navigator's settings: commands take effect at once here, and the lag is the car's own."""
    period = NavigatorOptions().period
    return NavigatorOptions(inline=True, delay=period, heading_tolerance=0.15)


def draw_trials(place: Place, solver: CarSolver, count: int, seed: int) -> list[Trial]:
    """Return trials whose starts and goals have room for the car; whether there is a way is left open."""
    random, limits = np.random.default_rng((seed, 22)), solver.limits
    free = np.argwhere(place.map.cells == 0)

    def anywhere() -> Array:
        while True:
            x, y = place.map.cell_to_world(*free[random.integers(len(free))])
            pose = np.array((x, y, random.uniform(-math.pi, math.pi)))
            if solver.fits(pose, limits.margin + _GAP):
                return pose

    def in_bay() -> Array:
        x, y, theta = place.bays[random.integers(len(place.bays))]
        theta += math.pi * (random.random() < 0.5)
        return np.array((x - limits.centre * math.cos(theta), y - limits.centre * math.sin(theta), theta))

    out = []
    while len(out) < count:
        start = in_bay() if len(place.bays) and random.random() < 1.0 - _IN_BAY else anywhere()
        goal = in_bay() if len(place.bays) and random.random() < _IN_BAY else anywhere()
        if solver.fits(start) and solver.fits(goal):
            out.append(Trial(start, goal))
    return out


class _Course(SimulatedRobot):
    """A simulated robot whose episodes end when the navigator has ended and the car stands, or after a time."""

    def __init__(self, world: SimulatedWorld, driver: NavigatorDriver, period: float) -> None:
        super().__init__(world, period)
        self._driver = driver
        self.longest = math.inf

    def step(self, command: Array) -> tuple[Sensors, float, bool, bool, dict[str, Any]]:
        sensors, reward, over, cut, info = super().step(command)
        ended = self._driver.decision.state in _ENDED and abs(self.world.velocity()[0]) < _STOOD
        return sensors, reward, over, cut or ended or self.world.elapsed >= self.longest, info


class Drives:
    """Drives of one car on one map in one engine.

    Args:
        place: The map, with its car.
        engine: Name of the engine.
        filtered: Whether the safety filter stands between navigator and car.

    Attributes:
        solver: Solver of the map.
        prepared: Duration of the preparation of the map, as before each new map [s].
    """

    def __init__(self, place: Place, engine: str, filtered: bool = False) -> None:
        self._place, self._filtered = place, filtered
        robot = find_robot(place.robot)
        limits, options = car_limits_of(robot), make_options()
        self.navigator = CarNavigator(limits, options)
        begin = time.monotonic()
        self.navigator.set_map(place.map)
        self.navigator.poll(0.0)
        self.prepared = time.monotonic() - begin
        self.solver = CarSolver(place.map, limits)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "map.yaml"
            place.map.save(file)
            task = NavigationTask.model_validate(task_content(file, np.zeros(3), place.robot))
            self.world = SimulatedWorld(task, 0, options=SimulationOptions(engine=engine))
        self._driver = NavigatorDriver(self.navigator, robot.lidar.x)
        self._robot = _Course(self.world, self._driver, options.period)
        self._now = 0.0

    def ride(self, trial: Trial, seed: int) -> Ride:
        """Drive one trial."""
        world, navigator = self.world, self.navigator
        world.reset(seed, trial.start)
        navigator.stand_at(trial.start)
        navigator.set_goal(Goal((float(trial.goal[0]), float(trial.goal[1])), float(trial.goal[2])))
        navigator.poll(self._now)
        value = navigator.value
        optimal = math.inf if value is None else float(value.value(trial.start)) + navigator.limits.stop_time
        self._robot.longest = _LONGEST * (optimal if math.isfinite(optimal) else 0.0) + _SPARE
        (episode,) = drive(self._robot, self._driver, self._filter(), seeds=(seed,))
        x, y, theta = world.pose()
        missed = math.dist((x, y), trial.goal[:2]), abs(math.remainder(theta - trial.goal[2], 2.0 * math.pi))
        contact = episode.info["smallest_clearance"] <= 0.0
        solved = math.nan if value is None else value.seconds
        return Ride(self._driver.decision.state, contact, world.elapsed, optimal, solved, missed)

    def _filter(self) -> SensorFilter | None:
        """Return a filter that has seen nothing yet; None without one."""
        if not self._filtered:
            return None
        period = self.navigator.options.period
        safety = make_filter(find_vehicle(self._place.robot), FilterOptions(period=period))
        return SensorFilter(safety, find_robot(self._place.robot).lidar.x)

    def close(self) -> None:
        """Release the engine."""
        self.world.close()


def rides(place: Place, engine: str, count: int, seed: int) -> Iterator[tuple[Trial, Ride]]:
    """Yield trials and their results."""
    drives = Drives(place, engine)
    try:
        for number, trial in enumerate(draw_trials(place, drives.solver, count, seed)):
            yield trial, drives.ride(trial, seed + number)
    finally:
        drives.close()

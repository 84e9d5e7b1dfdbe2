"""Simulated drives of the navigator, in one process and without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.navigation import Transform
from ctrl_rl_core.robots import DEFAULT_ROBOT
from numpy.typing import ArrayLike, NDArray
from sim_bridge.simulation import Localiser, correction

from ctrl_rl_core import (
    DriveSafety,
    FunctionDriver,
    NavigationTask,
    ObstacleStop,
    OccupancyMap,
    ScanHealth,
    Sensors,
    drive,
    find_robot,
)
from ctrl_rl_navigation.driving.decision import Decision, Goal, NavigatorOptions, NavigatorState
from ctrl_rl_navigation.driving.navigator import Navigator
from ctrl_rl_navigation.driving.navigator_driver import NavigatorDriver
from ctrl_rl_navigation.robot import DriveLimits, limits_of
from sim_bridge import RobotSenses, SimulatedWorld, SimulationOptions

Array = NDArray[np.float64]

_ENDED = (NavigatorState.REACHED, NavigatorState.UNREACHABLE)
_FAR = 1e4
_STOOD = 0.01
"""Speed below which a robot counts as stationary [m/s]."""
_MARGIN, _REACTION, _FASTER = 0.02, 0.3, 1.5
"""Margin [m] and reaction time [s] of the obstacle stop, and ratio of actual to commanded speed, as in the nodes."""
TASK_NAME = "drive_on_a_map"
"""Name of the task and of its file."""


def task_content(map_file: Path, pose: ArrayLike, robot: str = DEFAULT_ROBOT) -> dict[str, Any]:
    """Return the content of a task file: a robot that starts at a pose (3,) of a map, with an unreachable goal."""
    x, y, theta = np.asarray(pose, np.float64).tolist()
    mounted = find_robot(robot)
    return {
        "name": TASK_NAME,
        "kind": "navigation",
        "about": f"A {mounted.name} drives on a map.",
        "source": "a map",
        "system": {
            "model": "dubins_car",
            "controls": {"v": f"{mounted.speed} m/s", "omega": f"{-mounted.turn_rate} .. {mounted.turn_rate} rad/s"},
        },
        "robot": {"body": robot},
        "map": {"file": str(map_file.expanduser().resolve())},
        "start": {"x": f"{x} m", "y": f"{y} m", "theta": f"{theta} rad"},
        "goal": {"disc": {"centre": f"({_FAR}, {_FAR}) m", "radius": "0.1 m"}},
        "episode": {"steps": 10_000_000, "time_step": "0.1 s"},
        "rewards": {"goal": 0, "collision": 0},
    }


@dataclass(frozen=True)
class Errors:
    """Errors of the pose on the map, those of the bridge's localiser, which vary slowly.

    Attributes:
        drift: Standard deviation of odometry's relative errors.
        position: Standard deviation of each coordinate of the localiser's pose [m].
        heading: Standard deviation of the localiser's heading [rad].
        rate: Rate of the localiser's corrections [Hz].
    """

    drift: float = 0.05
    position: float = 0.05
    heading: float = math.radians(3.0)
    rate: float = 5.0


class LocalisedRobot:
    """The robot of a world with Gymnasium's interface; a localiser corrects its drifting odometry periodically.

    Info has `collided`. An episode is truncated after some time, or when the driver has finished and the robot is
    stationary.

    Attributes:
        trace: True poses (3,) at each command.
    """

    def __init__(self, world: SimulatedWorld, errors: Errors, random: np.random.Generator, period: float) -> None:
        self.trace: list[Array] = []
        self._world, self._corrections, self._steps = world, 1.0 / errors.rate, round(period * world.options.rate)
        self._localiser = Localiser(errors.position, errors.heading, errors.rate, random)
        self._correct_at = self._scan_at = 0.0
        self._correction = Transform.planar(0.0, 0.0, 0.0)
        self._senses, self._until = RobotSenses(world), math.inf
        self._is_done: Callable[[], bool] = lambda: False

    def begin(self, longest: float, is_done: Callable[[], bool]) -> None:
        """Set the maximum duration of the next episode [s], and the check whether the driver has finished."""
        self._until, self._is_done = self._world.elapsed + longest, is_done
        self._scan_at = self._world.elapsed

    def reset(self, *, seed: int) -> tuple[Sensors, dict[str, Any]]:  # noqa: ARG002 - the world was made of it
        """Start an episode at the robot's current state."""
        return self._sense(np.zeros(2)), {"collided": False}

    def step(self, command: Array) -> tuple[Sensors, float, bool, bool, dict[str, Any]]:
        """Hold a command (2,) for one period."""
        world = self._world
        world.command(0, command)
        self.trace.append(world.pose())
        ended = self._is_done() and abs(world.velocity()[0]) < _STOOD
        if not ended:
            world.step(self._steps)
        collided = world.episode().clearance <= 0.0
        cut = ended or world.elapsed >= self._until
        return self._sense(command), 0.0, collided, cut and not collided, {"collided": collided}

    def _sense(self, command: Array) -> Sensors:
        world, now = self._world, self._world.elapsed
        odometry = world.odometry().pose
        if now >= self._correct_at:
            self._correct_at = now + self._corrections
            self._correction = Transform.planar(*correction(self._localiser.update(world.pose()), odometry).tolist())
        look = now >= self._scan_at - 1e-9
        if look:
            self._scan_at += 1.0 / world.lidar.spec.rate
        pose = (self._correction @ Transform.planar(*odometry.tolist())).pose
        return self._senses(command, look, pose)


@dataclass(frozen=True)
class Drive:
    """Result of a drive.

    Attributes:
        state: State of the navigator at the end.
        collided: Whether the robot touched something.
        seconds: Simulated duration [s].
        distance: True distance from the goal at the end [m].
        waited: Time for which the robot was stationary [s].
        solves: Number of value functions solved.
    """

    state: NavigatorState
    collided: bool
    seconds: float
    distance: float
    waited: float
    solves: int


class DriveSimulation:
    """A robot with the navigator, the obstacle stop below it, and a localiser with errors."""

    def __init__(
        self,
        map_file: Path,
        pose: ArrayLike,
        seed: int,
        errors: Errors,
        limits: DriveLimits | None = None,
        engine: str = "pybullet",
        robot: str = DEFAULT_ROBOT,
    ) -> None:
        mounted, options = find_robot(robot), NavigatorOptions(inline=True)
        self.limits = limits or limits_of(mounted)
        settings = SimulationOptions(odom_drift=errors.drift, engine=engine)
        task = NavigationTask.model_validate(task_content(map_file, pose, robot))
        self.world, self._period = SimulatedWorld(task, seed, options=settings), options.period
        self.navigator = Navigator(self.limits, options)
        self.navigator.set_map(OccupancyMap.load(map_file))
        self._driver = NavigatorDriver(self.navigator, mounted.lidar.x)
        self.robot = LocalisedRobot(self.world, errors, np.random.default_rng((seed, 7)), options.period)
        stop = ObstacleStop(mounted.radius, _MARGIN, mounted.plan.braking, _REACTION)
        reach = stop.radius + stop.margin + abs(mounted.lidar.x) + stop.reach(_FASTER * mounted.speed, 0.5)
        self._safety = DriveSafety(ScanHealth(0.0, 6.3, 0), stop, mounted.lidar.x, reach)

    @property
    def decision(self) -> Decision:
        """Last decision of the navigator."""
        return self._driver.decision

    def drive(self, goal: Goal, longest: float) -> Drive:
        """Drive to a goal for at most `longest` seconds."""
        world, navigator, driver = self.world, self.navigator, self._driver
        begin, waited, solves = world.elapsed, 0.0, navigator.solves

        def decide(sensors: Sensors) -> Array:
            nonlocal waited
            command = driver.command(sensors)
            waited += self._period * (not command.any())
            return command

        navigator.set_goal(goal)
        self.robot.begin(longest, lambda: driver.decision.state in _ENDED)
        (episode,) = drive(self.robot, FunctionDriver(decide), self._safety, seeds=(world.seed,))
        distance, seconds = math.dist(world.pose()[:2], goal.position), world.elapsed - begin
        state, collided = driver.decision.state, episode.info["collided"]
        return Drive(state, collided, seconds, distance, waited, navigator.solves - solves)

    def close(self) -> None:
        """Release the physics client."""
        self.world.close()

"""Drives of the navigator in the simulator, in one process and without ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.robots.robot import DEFAULT_ROBOT
from ctrl_rl_core.sensing.scan import ScanError, view_scan
from numpy.typing import ArrayLike, NDArray
from sim_bridge.simulation.localisation import Localiser, correction

from ctrl_rl_core import DriveSafety, NavigationTask, ObstacleStop, OccupancyMap, ScanHealth, find_robot
from ctrl_rl_navigation.driving.decision import Decision, Goal, NavigatorOptions, NavigatorState
from ctrl_rl_navigation.driving.navigator import Navigator
from ctrl_rl_navigation.robot import DriveLimits, limits_of
from sim_bridge import SimulatedWorld, SimulationOptions

Array = NDArray[np.float64]

_ENDED = (NavigatorState.REACHED, NavigatorState.UNREACHABLE)
_FAR = 1e4
_MARGIN, _REACTION, _FASTER = 0.02, 0.3, 1.5
"""Margin [m] and reaction time [s] of the obstacle stop, and a robot's speed over that of its commands, as in nodes."""
TASK_NAME = "drive_on_a_map"
"""Name of the task, and of its file."""


def task_content(map_file: Path, pose: ArrayLike, robot: str = DEFAULT_ROBOT) -> dict[str, Any]:
    """Return the content of a task file: a robot that starts at a pose (3,) of a map and has nowhere to arrive."""
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
    """Errors of the pose in the map: those of the bridge's localiser, which vary slowly.

    Attributes:
        drift: Standard deviation of odometry's relative errors.
        position: Standard deviation of each coordinate of a localiser's pose [m].
        heading: Standard deviation of its heading [rad].
        rate: Corrections of the localiser per second [Hz].
    """

    drift: float = 0.05
    position: float = 0.05
    heading: float = math.radians(3.0)
    rate: float = 5.0


class LocalisedPose:
    """The pose in the map by a drifting odometry that a localiser corrects at a rate."""

    def __init__(self, world: SimulatedWorld, errors: Errors, random: np.random.Generator) -> None:
        self._world, self._period = world, 1.0 / errors.rate
        self._localiser = Localiser(errors.position, errors.heading, errors.rate, random)
        self._next = 0.0
        self._correction = np.zeros(3)

    def odometry(self) -> Array:
        """Return the pose by odometry (3,)."""
        return self._world.odometry().pose

    def pose(self) -> Array:
        """Return the pose in the map (3,)."""
        odometry = self.odometry()
        if self._world.elapsed >= self._next:
            self._next = self._world.elapsed + self._period
            self._correction = correction(self._localiser.update(self._world.pose()), odometry)
        return compose(self._correction, odometry)


def compose(first: Array, second: Array) -> Array:
    """Return a pose (3,) given in the frame of another one (3,), in the frame of that one's."""
    c, s = math.cos(first[2]), math.sin(first[2])
    x, y = first[0] + c * second[0] - s * second[1], first[1] + s * second[0] + c * second[1]
    return np.array((x, y, first[2] + second[2]))


def inverse(pose: Array) -> Array:
    """Return the inverse of a pose (3,)."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array((-c * pose[0] - s * pose[1], s * pose[0] - c * pose[1], -pose[2]))


def move(points: Array, pose: Array) -> Array:
    """Return points (n, 2) of a frame in the frame that its pose (3,) is given in."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.column_stack(
        (pose[0] + c * points[:, 0] - s * points[:, 1], pose[1] + s * points[:, 0] + c * points[:, 1])
    )


@dataclass(frozen=True)
class Drive:
    """The end of a drive.

    Attributes:
        state: State of the navigator at the end.
        collided: Whether the robot touched something.
        seconds: Simulated duration [s].
        distance: True distance from the goal at the end [m].
        waited: Part of the duration in which the robot stood [s].
        solves: Number of values that were solved.
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
        self._robot = find_robot(robot)
        self.limits = limits or limits_of(self._robot)
        self._options = NavigatorOptions(inline=True)
        settings = SimulationOptions(odom_drift=errors.drift, engine=engine)
        task = NavigationTask.model_validate(task_content(map_file, pose, robot))
        self.world = SimulatedWorld(task, seed, options=settings)
        self.navigator = Navigator(self.limits, self._options)
        self.navigator.set_map(OccupancyMap.load(map_file))
        self.localiser = LocalisedPose(self.world, errors, np.random.default_rng((seed, 7)))
        stop = ObstacleStop(self._robot.radius, _MARGIN, self._robot.plan.braking, _REACTION)
        reach = stop.radius + stop.margin + abs(self._robot.lidar.x) + stop.reach(_FASTER * self._robot.speed, 0.5)
        self._safety = DriveSafety(ScanHealth(0.0, 6.3, 0), stop, self._robot.lidar.x, reach)
        self._echoes = np.empty((0, 2))
        self._scan_pose, self._scan_at = self.localiser.odometry(), 0.0
        self.trace: list[Array] = []

    def drive(self, goal: Goal, longest: float) -> Drive:
        """Drive to a goal, for at most `longest` seconds."""
        world, rate = self.world, self.world.options.rate
        begin, waited, solves = world.elapsed, 0.0, self.navigator.solves
        self.navigator.set_goal(goal)
        period = round(self._options.period * rate)
        next_scan = world.elapsed
        state, collided = NavigatorState.WAITING, False
        while world.elapsed - begin < longest:
            pose = self.localiser.pose()
            if world.elapsed >= next_scan - 1e-9:
                next_scan += 1.0 / world.lidar.spec.rate
                self._look(pose)
            decision = self._step(pose)
            state = decision.state
            waited += self._options.period * (not decision.command.any())
            if state in _ENDED and abs(world.velocity()[0]) < 0.01:
                break
            world.step(period)
            if world.episode().clearance <= 0.0:
                collided = True
                break
        distance = math.dist(world.pose()[:2], goal.position)
        return Drive(state, collided, world.elapsed - begin, distance, waited, self.navigator.solves - solves)

    def _look(self, pose: Array) -> None:
        """Take a scan."""
        scan = self.world.laser_scan()
        now = self.world.elapsed
        forward, _, turn = self.world.odometry().velocity
        self._safety.update(now, round(1e9 * now), "scan", scan.ranges, scan.geometry, (forward, turn))
        self._echoes = view_scan(scan.ranges, scan.geometry, math.inf, self._robot.lidar.x).points
        self._scan_pose, self._scan_at = self.localiser.odometry(), now
        self.navigator.see(now, pose, self._echoes)

    def _step(self, pose: Array) -> Decision:
        """Send one command."""
        now = self.world.elapsed
        since = compose(inverse(self.localiser.odometry()), self._scan_pose)
        decision = self.navigator.decide(now, pose, move(self._echoes, since))
        try:
            command, _ = self._safety.limit(decision.command, self.world.odometry().velocity[0], now - self._scan_at)
        except ScanError:
            command = np.zeros(2)
        self.navigator.sent(command)
        self.world.command(0, command)
        self.trace.append(self.world.pose())
        return decision

    def close(self) -> None:
        """Give the physics client back."""
        self.world.close()

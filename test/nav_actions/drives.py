"""One drive along a path behind the safety filter, and its figures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from ctrl_rl_navigation.cli import Errors, LocalisedRobot, task_content
from ctrl_rl_safety.filter import SensorFilter
from numpy.typing import NDArray

from ctrl_rl_core import CtrlRlError, FunctionDriver, NavigationTask, Sensors, drive, find_robot
from ctrl_rl_safety import FilterOptions, SafetyFilter, find_model
from nav_actions.drivers import PERIOD, PathFollower
from nav_actions.paths import ROBOT, PathTrial
from sim_bridge import SimulatedWorld, SimulationOptions

Array = NDArray[np.float64]

_ERRORS = Errors(drift=0.05, position=0.02, heading=np.radians(1.0))
_SLOWNESS, _SPARE = 4.0, 30.0
"""A drive ends after this multiple of the time at full speed, plus this time [s]."""


class PathDrive(NamedTuple):
    """Figures of a drive.

    Attributes:
        arrived: Whether the robot stands at the end of the path.
        contact: Whether it touched anything.
        seconds: Duration over that at full speed along the path.
        error: Mean distance from the path [m].
        largest_error: Largest distance from the path [m].
    """

    arrived: bool
    contact: bool
    seconds: float
    error: float
    largest_error: float


def follow(trial: PathTrial, follower: PathFollower, seed: int) -> PathDrive:
    """Drive along a path; the robot starts at its beginning with a heading of its own."""
    start = np.array((*trial.path[0], trial.heading))
    task = NavigationTask.model_validate(task_content(trial.world_file, start, ROBOT))
    world = SimulatedWorld(task, seed, options=SimulationOptions(odom_drift=_ERRORS.drift))
    own = find_robot(ROBOT)
    best = float(np.linalg.norm(np.diff(trial.path, axis=0), axis=1).sum()) / own.plan.speed
    safety = SensorFilter(SafetyFilter(find_model(ROBOT), FilterOptions(period=PERIOD)), own.lidar.x, 0.2)

    def decide(sensors: Sensors) -> Array:
        try:
            return follower.command(sensors)
        except CtrlRlError:  # as in a node: the robot stands
            return np.zeros(2)

    try:
        robot = LocalisedRobot(world, _ERRORS, np.random.default_rng((seed, 32)), PERIOD)
        robot.begin(_SLOWNESS * best + _SPARE, lambda: follower.arrived or follower.failed)
        (episode,) = drive(robot, FunctionDriver(decide), safety, seeds=(seed,))
        away = distances(np.array(robot.trace)[:, :2], trial.path)
        contact = bool(episode.info["collided"])
        arrived = follower.arrived and not contact
        return PathDrive(arrived, contact, world.elapsed / best, float(away.mean()), float(away.max()))
    finally:
        world.close()


def distances(places: Array, path: Array) -> Array:
    """Return the distances of places (n, 2) from a path (m, 2) [m]."""
    starts, ways = path[:-1], np.diff(path, axis=0)
    squares = np.maximum((ways**2).sum(axis=1), 1e-12)
    t = np.clip(((places[:, None] - starts) * ways).sum(axis=2) / squares, 0.0, 1.0)
    return np.asarray(np.linalg.norm(places[:, None] - starts - t[..., None] * ways, axis=2).min(axis=1))

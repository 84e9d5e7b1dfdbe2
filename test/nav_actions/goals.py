"""A client of Nav2 sends goals to the real nodes: poses, waypoints and paths; it replaces and cancels."""

from __future__ import annotations

import math
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from ctrl_rl_navigation.cli import TASK_NAME, task_content
from ctrl_rl_navigation.maps import map_file
from ctrl_rl_navigation.robot import limits_of
from nav2_client import ABORTED, CANCELED, SUCCEEDED, Nav2Client, path_through, pose_at
from nav_msgs.msg import Odometry
from numpy.typing import NDArray

from ctrl_rl_core import SENSOR, OccupancyMap, find_robot, read_planar_pose
from ctrl_rl_navigation import MapSolver

Array = NDArray[np.float64]

KINDS = ("pose", "poses", "waypoints", "path", "replaced", "cancelled", "unreachable")
_MAP, _ROBOT = "maze", "turtlebot3_burger"
_ROOM, _FARTHEST = 0.1, 6.0
"""Room around goals beyond the robot's own, and the largest length of the way to one [m]."""
_TOLERANCE = 0.15 + 0.15
"""Goal tolerance, and what the localiser may be off [m]."""
_STANDS = 0.02
_LONGEST_S, _STOP_S = 300.0, 10.0


class Sent(NamedTuple):
    """What became of a goal.

    Attributes:
        kind: One of `KINDS`.
        as_expected: Whether status, result, feedback and the robot's true place are what a client of Nav2 expects.
        seconds: Wall time until the result [s].
    """

    kind: str
    as_expected: bool
    seconds: float


class Application(Nav2Client):
    """A client that also knows the truth."""

    def __init__(self) -> None:
        super().__init__()
        self.place, self.speed = np.full(3, np.nan), math.nan
        self.create_subscription(Odometry, "ground_truth", self._on_truth, SENSOR)

    def stands(self) -> bool:
        """Return whether the robot comes to rest."""
        self.speed, deadline = math.nan, time.monotonic() + _STOP_S
        while not self.speed < _STANDS and time.monotonic() < deadline:
            rclpy.spin_once(self, timeout_sec=0.05)
        return self.speed < _STANDS

    def _on_truth(self, message: Odometry) -> None:
        self.place = read_planar_pose(message.pose.pose)
        self.speed = abs(message.twist.twist.linear.x)


@contextmanager
def nodes(folder: Path, speed: float) -> Iterator[Application]:
    """Run simulator, navigator and safety filter, and give an application."""
    file = map_file(_MAP)
    (folder / f"{TASK_NAME}.yaml").write_text(yaml.safe_dump(task_content(file, _start(), _ROBOT), sort_keys=False))
    clock, noisy = "use_sim_time:=true", "localisation:=noisy"
    # The monitor would blame the robot for the delays of a simulator that runs fast beside other work.
    in_a_hall = ("largest_gap:=6.3", "min_echo_share:=0.02", "monitor:=false")
    running = [
        _run(folder, "sim_bridge", "bridge", f"task:={folder}/{TASK_NAME}.yaml", f"speed_factor:={speed}", noisy),
        _run(folder, "ctrl_rl_safety", "safety_filter", clock, *in_a_hall),
        _run(folder, "ctrl_rl_navigation", "navigator", clock, f"map:={file}", "goal_heading_tolerance:=3.2"),
    ]
    rclpy.init()
    application = Application()
    try:
        application.wait_for(lambda: bool(np.isfinite(application.place).all()))
        yield application
    finally:
        for process in running:
            process.send_signal(signal.SIGINT)
        for process in running:
            process.wait()
        application.destroy_node()
        rclpy.try_shutdown()


def _run(folder: Path, package: str, executable: str, *parameters: str) -> subprocess.Popen[bytes]:
    path = Path(get_package_prefix(package)) / "lib" / package / executable
    words = [word for each in parameters for word in ("-p", each)]
    remap = ("-r", "cmd_vel:=cmd_vel_raw") if executable == "navigator" else ()
    with (folder / f"{executable}.log").open("wb") as stream:
        return subprocess.Popen([path, "--ros-args", *words, *remap], stdout=stream, stderr=subprocess.STDOUT)


def _start() -> tuple[float, float, float]:
    return _roomy(np.random.default_rng(33), None)[0], _roomy(np.random.default_rng(33), None)[1], 0.0


def _roomy(random: np.random.Generator, near: Array | None) -> tuple[float, float]:
    """Return a place with room around it, and a short way from another one."""
    map_, limits = OccupancyMap.load(map_file(_MAP)), limits_of(find_robot(_ROBOT))
    solver = MapSolver(map_, limits)
    cells = np.argwhere(solver.clearance >= limits.room + _ROOM)
    value = None if near is None else solver.solve((float(near[0]), float(near[1])), 0.1, widest=0.4)
    while True:
        x, y = map_.cell_to_world(*cells[random.integers(len(cells))]).tolist()
        if value is None or 1.0 < float(value.value((x, y))) * limits.speed < _FARTHEST:
            return x, y


def send(application: Application, seed: int) -> Sent:
    """Send a goal, and compare what comes back with what Nav2's servers answer."""
    random, kind = np.random.default_rng((seed, 34)), KINDS[seed % len(KINDS)]
    begin = time.monotonic()
    x, y = _roomy(random, application.place)
    fits = _SENDERS[kind](application, x, y, random)
    return Sent(kind, fits, time.monotonic() - begin)


def _arrives(application: Application, x: float, y: float) -> bool:
    """Wait, and return whether the goal succeeds with the robot at its place."""
    application.wait(longest=round(10 * _LONGEST_S))
    status, result = application.getResult()
    here = application.stands() and math.dist(application.place[:2], (x, y)) <= _TOLERANCE
    return status == SUCCEEDED and result.error_code == 0 and here and bool(application.heard)


def _falls(values: list[float]) -> bool:
    """Return whether a remaining distance ends far below its begin."""
    return values[-1] < 0.5 * values[0] + 0.3


def _pose(application: Application, x: float, y: float, _: Any) -> bool:
    arrived = application.goToPose(pose_at(x, y)) and _arrives(application, x, y)
    heard = application.heard
    times = [each.navigation_time.sec + 1e-9 * each.navigation_time.nanosec for each in heard]
    return arrived and _falls([each.distance_remaining for each in heard]) and times == sorted(times)


def _poses(application: Application, x: float, y: float, random: np.random.Generator) -> bool:
    between = _roomy(random, np.array((x, y)))
    arrived = application.goThroughPoses([pose_at(*between), pose_at(x, y)]) and _arrives(application, x, y)
    left = [each.number_of_poses_remaining for each in application.heard]
    return arrived and left == sorted(left, reverse=True) and {1} <= set(left) <= {1, 2}  # the first may be at hand


def _waypoints(application: Application, x: float, y: float, random: np.random.Generator) -> bool:
    between = _roomy(random, np.array((x, y)))
    arrived = application.followWaypoints([pose_at(*between), pose_at(x, y)]) and _arrives(application, x, y)
    missed = application.getResult()[1].missed_waypoints
    return arrived and not missed and {each.current_waypoint for each in application.heard} == {0, 1}


def _path(application: Application, x: float, y: float, _: Any) -> bool:
    solver = MapSolver(OccupancyMap.load(map_file(_MAP)), limits_of(find_robot(_ROBOT)))
    path = solver.solve((x, y), 0.05, widest=0.2).path(application.place[:2])
    arrived = application.followPath(path_through(*map(tuple, path.tolist()))) and _arrives(application, *path[-1])
    return arrived and _falls([each.distance_to_goal for each in application.heard])


def _replaced(application: Application, x: float, y: float, random: np.random.Generator) -> bool:
    first = _roomy(random, application.place)
    application.goToPose(pose_at(*first))
    application.wait(lambda: len(application.heard) > 5)
    old = application.result
    arrived = application.goToPose(pose_at(x, y)) and _arrives(application, x, y)
    return arrived and old.done() and old.result().status in (ABORTED, SUCCEEDED)


def _cancelled(application: Application, x: float, y: float, _: Any) -> bool:
    application.goToPose(pose_at(x, y))
    application.wait(lambda: len(application.heard) > 15)
    application.cancelTask()
    application.wait()
    return application.getResult()[0] in (CANCELED, SUCCEEDED) and application.stands()


def _unreachable(application: Application, _x: float, _y: float, _: Any) -> bool:
    application.goToPose(pose_at(100.0, 0.0))
    application.wait()
    status, result = application.getResult()
    return status == ABORTED and result.error_code == 208 and bool(result.error_msg) and application.stands()


_SENDERS = dict(zip(KINDS, (_pose, _poses, _waypoints, _path, _replaced, _cancelled, _unreachable), strict=True))

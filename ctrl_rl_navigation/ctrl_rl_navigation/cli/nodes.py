"""Trials through the real nodes: simulator, navigator, and this process as the operator who sets goals."""

from __future__ import annotations

import math
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from ctrl_rl_core.processes import start_child
from ctrl_rl_core.ros import LATCHED, seconds
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry

from ctrl_rl_core import RESULT, SENSOR, OccupancyMap, find_robot, read_planar_pose
from ctrl_rl_msgs.msg import EpisodeStatus, NavigatorStatus
from ctrl_rl_navigation.cli.goals import GoalMaker, Trial
from ctrl_rl_navigation.cli.outcome import Options, Outcome
from ctrl_rl_navigation.cli.simulation import TASK_NAME, Drive, task_content
from ctrl_rl_navigation.driving.decision import NavigatorOptions, NavigatorState
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.robot import limits_of

_ENDED = (NavigatorStatus.REACHED, NavigatorStatus.UNREACHABLE)
_SPEED = 3.0
"""Real-time factor of the simulation."""
_START_S = 60.0
_LONGEST, _SPARE_S = 4.0, 30.0


class _Operator:
    """Publishes goals and monitors the drive."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("trials")
        self.status: NavigatorStatus | None = None
        self.pose = np.full(3, np.nan)
        self.now, self.clearance = 0.0, math.inf
        self._goal = self.node.create_publisher(PoseStamped, "goal_pose", 10)
        self.node.create_subscription(NavigatorStatus, "navigator/status", self._on_status, LATCHED)
        self.node.create_subscription(Odometry, "ground_truth", self._on_truth, SENSOR)
        self.node.create_subscription(EpisodeStatus, "episode", self._on_episode, RESULT)

    def ready(self) -> bool:
        """Return whether the navigator is waiting for a goal and the robot's position is known."""
        waits = self.status is not None and self.status.message == "waiting for a goal"
        return waits and bool(np.isfinite(self.pose).all()) and self._goal.get_subscription_count() > 0

    def click(self, place: tuple[float, float]) -> None:
        """Publish a goal with any heading."""
        self.status = None
        message = PoseStamped()
        message.header.frame_id = "map"
        message.pose.position.x, message.pose.position.y = place
        message.pose.orientation.w = 0.0
        self._goal.publish(message)

    def spin(self) -> None:
        """Process all received messages."""
        rclpy.spin_once(self.node, timeout_sec=0.05)

    def _on_status(self, message: NavigatorStatus) -> None:
        self.status = message

    def _on_truth(self, message: Odometry) -> None:
        self.pose = read_planar_pose(message.pose.pose)
        self.now = seconds(message.header.stamp)

    def _on_episode(self, message: EpisodeStatus) -> None:
        self.clearance = min(self.clearance, message.clearance)


def _start(package: str, executable: str, log: Path, parameters: dict[str, Any]) -> subprocess.Popen[bytes]:
    path = Path(get_package_prefix(package)) / "lib" / package / executable
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    with log.open("wb") as stream:
        return start_child([path, "--ros-args", *words], stdout=stream, stderr=subprocess.STDOUT)


@contextmanager
def _nodes(file: Path, start: Any, options: Options, engine: str) -> Iterator[_Operator]:
    """Start the nodes and yield an operator; the nodes end with the context.

    Raises:
        NavigationError: A node ended, or did not start in time; the message contains its last output line.
    """
    running: list[tuple[subprocess.Popen[bytes], Path]] = []
    with tempfile.TemporaryDirectory(prefix="trials_") as name:
        folder = Path(name)
        task = folder / f"{TASK_NAME}.yaml"
        task.write_text(yaml.safe_dump(task_content(file, start, options.robot), sort_keys=False))
        simulator = {
            "task": task,
            "seed": options.seed,
            "engine": engine,
            "speed_factor": _SPEED,
            "odom_drift": float(options.drift),
            "localisation": "noisy",
            "localisation_error": float(options.position_error),
            "localisation_heading_error": math.radians(options.heading_error),
        }
        driver: dict[str, Any] = {"map": file.resolve(), "robot": options.robot, "use_sim_time": "true"}
        operator = _Operator()
        try:
            for package, executable, parameters in (
                ("sim_bridge", "bridge", simulator),
                ("ctrl_rl_navigation", "navigator", driver),
            ):
                log = folder / f"{executable}.log"
                running.append((_start(package, executable, log, parameters), log))
            deadline = time.monotonic() + _START_S
            while not operator.ready():
                operator.spin()
                dead = [log for process, log in running if process.poll() is not None]
                if dead or time.monotonic() > deadline:
                    said = (dead or [running[-1][1]])[0]
                    last = said.read_text(errors="replace").strip().splitlines()[-1:]
                    raise NavigationError(f"{said.stem} did not start: {' '.join(last)}")
            yield operator
        finally:
            for process, _ in running:
                process.terminate()
            for process, _ in running:
                process.wait()
            operator.node.destroy_node()


def drive_through_nodes(file: Path, map_: OccupancyMap, options: Options, engine: str, made: int) -> Iterator[Outcome]:
    """Yield the outcome of each remaining trial on a map; each one starts where the previous one ended."""
    limits, tolerance = limits_of(find_robot(options.robot)), NavigatorOptions().tolerance
    maker = GoalMaker(map_, limits, tolerance)
    trials = list(maker.draw(np.random.default_rng((options.seed, 1)), options.goals))[made:]
    rclpy.init()
    try:
        while trials:
            with _nodes(file, trials[0].start, options, engine) as operator:
                while trials:
                    outcome = _drive(operator, maker, trials.pop(0).goal)
                    yield outcome
                    if outcome.drive.collided:  # continue from a new start
                        break
    finally:
        rclpy.try_shutdown()


def _drive(operator: _Operator, maker: GoalMaker, goal: tuple[float, float]) -> Outcome:
    start = operator.pose.tolist()
    best = maker.best_time(start, goal)
    trial = Trial((start[0], start[1], start[2]), goal, math.isfinite(best))
    longest = _LONGEST * (best if trial.reachable else 0.0) + _SPARE_S
    begin, asked = operator.now, time.monotonic()
    operator.clearance = math.inf
    operator.click(goal)
    status = operator.status
    while operator.now - begin < longest and operator.clearance > 0.0:
        operator.spin()
        status = operator.status
        if status is not None and status.state in _ENDED:
            break
    state = NavigatorState.WAITING if status is None else NavigatorState(status.state)
    told = state is NavigatorState.UNREACHABLE and not trial.reachable
    answered = time.monotonic() - asked if told else math.nan
    drive = Drive(
        state,
        operator.clearance <= 0.0,
        operator.now - begin,
        math.dist(operator.pose[:2], goal),
        math.nan,
        0,
    )
    return Outcome(trial, drive, best, answered)

"""The simulated corridor for learning: lidar and odometry of a TurtleBot3, commands as in its firmware.

Training uses several such corridors in a row, so that an episode without a collision is as long as in the thesis, about
700 steps. Lidar, drop-out and delay are randomised per episode, for robustness.

The reward is this suite's own, because the thesis does not specify one: progress along the path, minus penalties for
proximity to walls and for turning, plus the task's rewards for goal and collision at the end, as multiples of the
reward of a step at full speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from ctrl_rl_core.robots import DEFAULT_ROBOT
from ctrl_rl_core.tasks import CorridorSpec, PathCoordinates
from gymnasium import spaces
from numpy.typing import NDArray

from ctrl_rl_core import Interval, NavigationTask, Outcome, ScanGeometry, find_robot, load_navigation_task
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.policies.latent_policy import RobotInterface
from koopman_lqr_controller.sensing.lidar_observation import LidarObservation
from koopman_lqr_controller.training.replay import Mirror
from sim_bridge import SimulatedWorld, SimulationOptions

_BESIDE, _ASKEW = 0.12, 30.0
"""Maximum initial offset from the centre line in training [m], and heading [deg]."""
_AT_SPEED = 0.9
"""Fraction of an episode needed at full speed to drive through the corridors of a training episode."""
_LIDARS, _MOST_DROPOUT, _LONGEST_DELAY = ("lds01", "lds02"), 0.1, 0.1
"""Randomised lidars, maximum probability of a lost beam, and maximum command delay [s]."""
_RATE = 60
_FASTEST, _HARDEST = find_robot(DEFAULT_ROBOT).speed, 1.5
"""Maximum commands of a policy, forwards [m/s] and to both sides [rad/s]; lower if the task allows less."""
_NEAR_WALL = 0.15
"""Clearance below which the reward of a step is reduced [m]."""
_TURN_COST = 0.2
"""Cost of a step at the maximum turn rate, quadratic below; without it the robot zigzags."""
_ADVANCE, _STALL = 0.05, 10.0
"""Minimum progress [m] within a time [s], below which an episode is truncated."""
_COLLISION_SCALE, _GOAL_SCALE = 1 / 20, 1 / 50
"""Scales of the task's terminal rewards in steps at full speed: -20 and 20."""

Vector = NDArray[np.float32]


@dataclass(frozen=True)
class Conditions:
    """Conditions that make a robot harder to drive.

    Attributes:
        lidar: Lidar kind, one of `sim_bridge.simulation.lidar.LIDARS`.
        dropout: Probability that a beam is lost.
        delay: Time from a command to its effect [s].
        noise: Standard deviation of a range [m]; None for the task's.
    """

    lidar: str = "lds01"
    dropout: float = 0.0
    delay: float = 0.0
    noise: float | None = None

    @classmethod
    def drawn(cls, random: np.random.Generator) -> Conditions:
        """Draw random lidar, drop-out and delay."""
        return cls(str(random.choice(_LIDARS)), random.uniform(0.0, _MOST_DROPOUT), random.uniform(0.0, _LONGEST_DELAY))


class Corridor(gymnasium.Env[Vector, Vector]):
    """The task `curved_corridor` with random widths and the firmware's command truncation.

    Observation: `LidarObservation`. Action: [-1, 1] for speed and turn rate, mapped to the commands of
    `robot_interface`. Info: `outcome`, `progress` and `clearance` [m].

    Attributes:
        task: Simulated task.
        robot_interface: Connection of the robot to a policy.
        mirror: Symmetry of left and right.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - gymnasium's own form

    def __init__(
        self, learning: bool = True, conditions: Conditions | None = None, task: str = "curved_corridor"
    ) -> None:
        """Build the world.

        Args:
            learning: Whether to chain several corridors, with starts anywhere in the first one; otherwise the task is
                unchanged.
            conditions: Conditions of all episodes; None to draw them per episode.
            task: Name or file of a task with a corridor.

        Raises:
            KoopmanError: The task has no corridor, its command limits are too low, or the physics rate does not match
                its time step.
            TaskError: The task does not exist.
        """
        self.task = load_navigation_task(task)
        if self.task.corridor is None:
            raise KoopmanError(f"task '{self.task.name}' has no corridor")
        speed, turn = _limits(self.task)
        if learning:
            self.task = _in_a_row(self.task, self.task.corridor, speed.high)
        self.dt = self.task.episode.time_step
        steps = self.dt * _RATE
        if abs(steps - round(steps)) > 1e-6:
            raise KoopmanError(f"task '{self.task.name}': its time step is not a whole number of 1/{_RATE} s")
        self._steps = round(steps)
        self._conditions = conditions
        self._world = self._make_world(0, conditions or Conditions())
        self.robot_interface = RobotInterface(
            LidarObservation(), np.array((speed.low, turn.low)), np.array((speed.high, turn.high))
        )
        self.mirror = Mirror(*self.robot_interface.observation.mirror, np.array((1.0, -1.0)))
        self._full_step = speed.high * self.task.episode.time_step
        path = self._world.geometry.path
        assert path is not None
        self._path_coordinates = PathCoordinates(path)  # the same for every width
        self._along = self._furthest = 0.0
        self._since = 0
        size = len(self.robot_interface.observation.names)
        self.observation_space = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Vector, dict[str, Any]]:
        """Start an episode; the same seed gives the same episode. `options` has no effect."""
        super().reset(seed=seed, options=options)
        conditions = self._conditions or Conditions.drawn(self.np_random)
        self._world.close()
        self._world = self._make_world(int(self.np_random.integers(2**32)), conditions)
        self._along = self._furthest = self._s()
        self._since = 0
        return self.observe(), self._info(Outcome.RUNNING)

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Hold an action (2,) for the task's time step."""
        u = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        self._world.command(0, self.robot_interface.command(u))
        self._world.step(self._steps)
        episode, before = self._world.episode(0), self._along
        self._along = self._s()
        reward = (self._along - before) / self._full_step
        reward -= max(0.0, 1.0 - max(0.0, episode.clearance) / _NEAR_WALL)
        reward -= _TURN_COST * float(u[1]) ** 2
        outcome = Outcome.TIMEOUT if episode.outcome is Outcome.RUNNING and self._stalls() else episode.outcome
        truncated = outcome is Outcome.TIMEOUT
        terminated = outcome is not Outcome.RUNNING and not truncated
        if terminated:
            scale = _GOAL_SCALE if outcome is Outcome.GOAL else _COLLISION_SCALE
            reward += scale * episode.reward(self.task.rewards)
        return self.observe(), reward, terminated, truncated, self._info(outcome)

    def close(self) -> None:
        """Release the physics client."""
        self._world.close()

    def _make_world(self, seed: int, conditions: Conditions) -> SimulatedWorld:
        options = SimulationOptions(
            rate=_RATE,
            lidar=conditions.lidar,
            scan_noise=conditions.noise,
            scan_dropout=conditions.dropout,
            command_truncation=True,
            command_delay=conditions.delay,
            randomise_width=True,
        )
        return SimulatedWorld(self.task, seed, options=options)

    def _s(self) -> float:
        """Return the robot's arc length along the path [m]."""
        return float(self._path_coordinates(self._world.pose(0))[0])

    def scan(self) -> tuple[NDArray[np.float32], ScanGeometry]:
        """Return the lidar's ranges (beams,) [m] and their geometry."""
        scan = self._world.laser_scan(0)
        return scan.ranges, scan.geometry

    def speeds(self) -> tuple[float, float]:
        """Return the odometry's speed [m/s] and turn rate [rad/s]."""
        forward, _, turn = self._world.odometry(0).velocity
        return forward, turn

    def observe(self) -> Vector:
        """Return the observation of the current state, with new noise and drop-out in each call."""
        return self.robot_interface.observation.observe(*self.scan(), *self.speeds()).astype(np.float32)

    def _stalls(self) -> bool:
        """Return whether the robot has made no progress for too long."""
        if self._along > self._furthest + _ADVANCE:
            self._furthest, self._since = self._along, 0
        self._since += 1
        return self._since * self.dt > _STALL

    def _info(self, outcome: Outcome) -> dict[str, Any]:
        episode = self._world.episode(0)
        progress = 0.0 if math.isnan(episode.progress) else episode.progress
        return {"outcome": outcome.name, "progress": progress, "clearance": episode.clearance}


def _limits(task: NavigationTask) -> tuple[Interval, Interval]:
    """Return the limits of speed [m/s] and turn rate [rad/s], symmetric to both sides."""
    if not task.robot.commands.keys() >= {"v", "omega"}:
        raise KoopmanError(f"task '{task.name}' has a {task.robot.body}: must have wheels")
    speed, turn = task.robot.commands["v"], task.robot.commands["omega"]
    fastest, hardest = min(_FASTEST, speed.high), min(_HARDEST, turn.high, -turn.low)
    slowest = max(0.0, speed.low)
    if slowest >= fastest or hardest <= 0.0:
        allowed = f"{speed.low:g} .. {speed.high:g} m/s, {turn.low:g} .. {turn.high:g} rad/s"
        raise KoopmanError(f"task '{task.name}' allows {allowed}: a policy drives forwards and turns to both sides")
    return Interval(slowest, fastest), Interval(-hardest, hardest)


def _in_a_row(task: NavigationTask, corridor: CorridorSpec, speed: float) -> NavigationTask:
    """Return the task with its corridor repeated as often as an episode permits, and the goal at the end."""
    length, most = corridor.path.length, task.episode.steps * task.episode.time_step * speed * _AT_SPEED
    count = max(1, int(most / length))
    while count > 1 and _meets_itself(corridor, count):
        count -= 1
    goal, before = task.goal.intervals["s"], (count - 1) * length
    start = {
        "s": f"{task.start.intervals['s'].low} .. {0.8 * length:.1f} m",
        "lateral": f"{-_BESIDE} .. {_BESIDE} m",
        "heading": f"{-_ASKEW} .. {_ASKEW} deg",
    }
    end = {"s": f"{goal.low + before} .. {goal.high + before} m"}
    return task.model_copy(
        update={
            "start": type(task.start).model_validate(start),
            "goal": type(task.goal).model_validate(end),
            "corridor": _repeated(corridor, count),
        }
    )


def _repeated(corridor: CorridorSpec, count: int) -> CorridorSpec:
    return corridor.model_copy(update={"pieces": count * corridor.pieces})


def _meets_itself(corridor: CorridorSpec, count: int) -> bool:
    """Return whether this many corridors in a row would overlap."""
    path, apart = _repeated(corridor, count).path, corridor.width_range.high + 2.0 * corridor.wall_thickness
    s = np.arange(0.0, path.length, 0.25 * apart)
    places = path.pose(s)[:, :2]
    distances = np.linalg.norm(places[:, None] - places, axis=2)
    return bool((distances[np.abs(s[:, None] - s) > 0.5 * np.pi * apart] < apart).any())

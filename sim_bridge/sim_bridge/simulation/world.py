"""A simulated world without ROS: a task and its robots, advanced in whole physics steps.

    world = SimulatedWorld(load_navigation_task("curved_corridor"), seed=1)
    world.command(0, (0.2, 0.0))
    world.step(48)
    world.scan(0), world.odometry(0), world.episode(0).outcome

Robots are numbered from 0; (n,) is the task system's number of states.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from ctrl_rl_core.sensing import planar
from ctrl_rl_core.tasks import MODEL
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import NavigationTask, Outcome, Sensors, System, make_odometry
from sim_bridge.engines.choice import make_engine
from sim_bridge.simulation.bodies import Body, make_body
from sim_bridge.simulation.commands import CommandChannel
from sim_bridge.simulation.draws import Purpose, checked_start, draw_episode, stream
from sim_bridge.simulation.episode import Contact, EpisodeState, TerminationChecker
from sim_bridge.simulation.lidar import Lidar, LidarScan
from sim_bridge.simulation.movers import Movers, MoverStates
from sim_bridge.simulation.odometry import Odometry, OdometryReading
from sim_bridge.simulation.options import SimulationOptions
from sim_bridge.simulation.plane_frame import PlaneFrame

Array = NDArray[np.float64]

TOUCH = 5e-4
"""Distance below which bodies touch [m]; an engine's contacts keep a smaller distance."""
_JUDGED_PER_SECOND = 30


@dataclass
class _Robot:
    body: Body
    channel: CommandChannel
    odometry: Odometry
    scan_random: np.random.Generator
    start_s: float
    episode: EpisodeState
    measured_at: int = -1  # physics step of the last measured clearance
    judged_at: int = -1
    speed: float = 0.0  # speed of the fastest point at the last check


class SimulatedWorld:
    """A task's world with any number of identical robots.

    The same seed, options and commands give bitwise identical results on the same machine.

    Attributes:
        task: Simulated task.
        plane: Plane of the task, "xy" or "xz".
        system: Model of the task, which defines names and order of the states.
        options: Settings of the simulation.
        geometry: Walls and obstacles of this episode.
        conditions: Settings of this episode, including random ones.
        seed: Seed of this episode.
        lidar: Lidar of each robot.
        engine: Name of the physics engine.
        steps: Physics steps since the reset.
    """

    def __init__(
        self,
        task: NavigationTask,
        seed: int = 0,
        robots: int = 1,
        width: float | None = None,
        options: SimulationOptions | None = None,
    ) -> None:
        """Build a world and its first episode.

        Args:
            task: Task to simulate.
            seed: Seed of the first episode.
            robots: Number of robots.
            width: Free width of a corridor in every episode [m]; None for the task's.
            options: Settings of the simulation; the default settings if omitted.

        Raises:
            SimulationError: There is no room for the robots, or the engine is not available.
            TaskError: The width is invalid for the task.
        """
        self.options = options or SimulationOptions()
        self.task = task
        self.system: System = task.system.build()
        turns = self.options.scan_rate
        spec = task.lidar if turns is None else task.lidar.model_copy(update={"rate": turns})
        self.lidar = Lidar(spec, self.options.lost_beam, self.options.lidar)
        self._count, self._width = robots, width
        self.plane = task.plane
        self._frame = PlaneFrame(self.plane, self.system)
        self._judge_every = max(1, self.options.rate // _JUDGED_PER_SECOND)
        self._robots: list[_Robot] = []
        engine = "planar" if task.robot.body == MODEL and self.options.engine == "auto" else self.options.engine
        self._engine = make_engine(engine, self.options.rate, self.options.gui)
        self.engine: str = self._engine.name
        try:
            self.reset(seed)
        except Exception:
            self.close()
            raise

    def reset(self, seed: int, start: ArrayLike | None = None) -> None:
        """Build a new episode; on an error the old one continues.

        Args:
            seed: Seed of the episode.
            start: State (n,) in which the only robot starts; drawn from the task's start set by default.

        Raises:
            SimulationError, TaskError: As for the constructor.
        """
        wanted = None if start is None else checked_start(start, self.system, self._count)
        geometry, conditions, plans, starts = draw_episode(
            self.task, self.system, self.options, seed, self._count, self._width, wanted
        )
        self._engine.begin(self.plane, (*geometry.walls, *geometry.obstacles))
        self.geometry = geometry
        self.conditions = conditions
        self.lidar.set_errors(conditions.scan_noise, conditions.scan_dropout)
        self.seed = seed
        self.steps = 0
        self._termination = TerminationChecker(self.task, self.system, geometry.path)
        bodies = [make_body(self._engine, self.task, self.system, start, conditions) for start in starts]
        self._movers = Movers(self._engine, plans, self.options.rate, self.task.robot.radius)
        self._engine.finish()
        self._robots = [self._make_robot(index, body) for index, body in enumerate(bodies)]
        self._check()

    def _make_robot(self, index: int, body: Body) -> _Robot:
        options, rate = self.conditions, self.options.rate
        channel = CommandChannel(
            body.bounds,
            body.idle,
            truncation=options.command_truncation and self.plane == "xy",
            delay=round(options.command_delay * rate),
            timeout=math.ceil(options.command_timeout * rate),
        )
        pose = body.pose()
        return _Robot(
            body=body,
            channel=channel,
            odometry=Odometry(
                options.odom_drift,
                stream(self.seed, Purpose.ODOMETRY, index),
                self._frame.counter_clockwise(pose),
                options.wheel_radius,
            ),
            scan_random=stream(self.seed, Purpose.SCAN, index),
            start_s=self._termination.start_s(pose),
            episode=EpisodeState(),
        )

    def __len__(self) -> int:
        """Return the number of robots."""
        return self._count

    @property
    def elapsed(self) -> float:
        """Simulation time since the reset [s]."""
        return self.steps / self.options.rate

    @property
    def rest(self) -> Array:
        """Idle command (2,): zeros, or the hover thrusts of a quadrotor [N]."""
        return self._robots[0].body.idle

    def command(self, robot: int, command: ArrayLike) -> bool:
        """Set a robot's command (2,): v, omega [m/s, rad/s] or t1, t2 [N]; return False if it is not finite."""
        return self._robots[robot].channel.send(command, self.steps)

    def step(self, count: int = 1) -> None:
        """Advance by `count` physics steps."""
        for _ in range(count):
            for robot in self._robots:
                robot.body.act(robot.channel.at(self.steps))
            if self._movers:
                self._movers.advance(self.steps, self._places)
            self._engine.step()
            self.steps += 1
            if self.steps >= self._next_check:
                self._check()

    def pose(self, robot: int = 0) -> Array:
        """Return the true pose x, y, theta or x, z, psi (3,) [m, m, rad]."""
        return self._robots[robot].body.pose()

    def quaternion(self, robot: int = 0) -> tuple[float, float, float, float]:
        """Return the true attitude (x, y, z, w)."""
        return self._robots[robot].body.quaternion()

    def velocity(self, robot: int = 0) -> Array:
        """Return the true velocity along the body's axes in the plane and the turn rate (3,) [m/s, m/s, rad/s]."""
        body = self._robots[robot].body
        return self._frame.in_body_axes(body.pose()[2], body.velocity())

    def wheel_angles(self, robot: int = 0) -> tuple[float, float] | None:
        """Return the angles of the left and right wheel [rad]; None without wheels."""
        return self._robots[robot].body.wheel_angles()

    def state(self, robot: int = 0) -> Array:
        """Return the true state (n,) of the task's system, angles in [-pi, pi)."""
        return self._state_of(self._robots[robot].body)

    def _state_of(self, body: Body) -> Array:
        known = body.state()
        return self._frame.named(body.pose(), body.velocity()) if known is None else known

    def measured_state(self, robot: int = 0) -> Array:
        """Return the state (n,) from odometry."""
        reading, known = self.odometry(robot), self._robots[robot].body.state()
        if known is not None:
            return self._frame.placed(known, reading.pose)
        return self._frame.named(reading.pose, self._frame.from_body_axes(reading.pose[2], reading.velocity))

    def odometry(self, robot: int = 0) -> OdometryReading:
        """Return the measured pose and velocity."""
        entry = self._robots[robot]
        pose = self._frame.counter_clockwise(entry.odometry.update(self._frame.counter_clockwise(entry.body.pose())))
        forward, sideways, turn = self.velocity(robot)
        forward, turn = entry.odometry.speeds(forward, turn)
        return OdometryReading(pose, np.array((forward, sideways, turn)))

    def scan(self, robot: int = 0) -> NDArray[np.float32]:
        """Return the ranges (beams,) [m] of `laser_scan`."""
        return self.laser_scan(robot).ranges

    def laser_scan(self, robot: int = 0) -> LidarScan:
        """Return one scan of the lidar; each call draws new noise."""
        entry = self._robots[robot]
        frame = entry.body.sensor()
        buried = False
        if self.clearance(robot) <= 0.0:
            place = frame.origin[[0, 1] if self.plane == "xy" else [0, 2]]
            buried = bool(self.geometry.signed_distance(place) < 0.0) or self._movers.hold(place)
        scan = self.lidar.scan(self._engine, frame, robot, entry.scan_random, buried)
        mounted = self.task.robot.robot
        return scan if mounted is None or mounted.lidar.yaw == 0.0 else replace(scan, yaw=mounted.lidar.yaw)

    def sensors(
        self, robot: int = 0, goal: Array | None = None, command: Array | None = None, scan: LidarScan | None = None
    ) -> Sensors:
        """Return a robot's current sensor readings, with its odometry pose.

        Args:
            robot: Index of the robot.
            goal: Goal x, y, theta (3,) [m, m, rad], or None.
            command: Last command (2,); zeros by default.
            scan: Current scan; a new one by default.
        """
        scan, reading = scan or self.laser_scan(robot), self.odometry(robot)
        odometry = make_odometry(reading.pose, reading.velocity, self.plane)
        last = np.zeros(2) if command is None else command
        return Sensors(scan.ranges, scan.geometry, odometry, planar(odometry[:7].tolist()), goal, last, self.elapsed)

    def clearance(self, robot: int = 0) -> float:
        """Return the distance from the body to the nearest wall, obstacle, mover or robot [m]; at most 0 on contact."""
        entry = self._robots[robot]
        if entry.measured_at != self.steps:
            known = entry.episode.clearance
            distance = self._engine.distance(robot, 1.0 if math.isinf(known) else known + 0.1)
            running = entry.episode.outcome is Outcome.RUNNING
            entry.episode.record_clearance(distance if distance > TOUCH else min(distance, 0.0))
            if running and entry.episode.outcome is Outcome.COLLISION:
                entry.episode.contact = Contact(entry.speed, self._movers.touching(robot, TOUCH))
            entry.measured_at = self.steps
        return entry.episode.clearance

    def episode(self, robot: int = 0) -> EpisodeState:
        """Return the current state of the robot's episode."""
        self._bring_up_to_date(robot)
        return self._robots[robot].episode

    def movers(self) -> MoverStates:
        """Return the current positions of the task's movers."""
        return self._movers.states()

    def close(self) -> None:
        """Release the physics engine; may be called twice."""
        self._engine.close()

    def _places(self) -> list[tuple[float, float]]:
        """Return the robots' positions [m]."""
        poses = [robot.body.pose() for robot in self._robots]
        return [(float(pose[0]), float(pose[1])) for pose in poses]

    def _check(self) -> None:
        """Check all robots and schedule the next check: at 30 Hz, or sooner if a contact is possible."""
        for robot in range(self._count):
            self._bring_up_to_date(robot)
        horizon = self._judge_every / self.options.rate
        speeds = [entry.body.top_speed(horizon) for entry in self._robots]
        closing = max(speeds) + max(max(speeds) if self._count > 1 else 0.0, self._movers.top_speed)
        free = min(entry.episode.clearance for entry in self._robots)
        steps = self._judge_every
        if free < closing * horizon:
            steps = max(1, int(free / closing * self.options.rate))  # 1 if the speed is unknown
        self._next_check = self.steps + steps

    def _bring_up_to_date(self, robot: int) -> None:
        entry = self._robots[robot]
        if entry.judged_at == self.steps:
            return
        entry.judged_at = self.steps
        self.clearance(robot)
        pose, velocity = entry.body.pose(), entry.body.velocity()
        state = self._state_of(entry.body)
        self._termination.check(entry.episode, state, pose, self.elapsed, entry.start_s)
        entry.speed = float(math.hypot(velocity[0], velocity[1]) + abs(velocity[2]) * entry.body.radius)

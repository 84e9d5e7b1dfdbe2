"""The bridge node: simulates robots and publishes their topics."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from builtin_interfaces.msg import Time
from ctrl_rl_core.ros import Status, ok, to_stamp, warn
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.clock import Clock, ClockType
from std_srvs.srv import SetBool

from ctrl_rl_core import COMMAND, CtrlRlError, Outcome, ParameterError, SuiteNode, load_navigation_task, run_node
from ctrl_rl_msgs.msg import RotorThrusts
from ctrl_rl_msgs.srv import ResetWorld, StepWorld
from sim_bridge.ros.frames import Frames, TransformPublisher
from sim_bridge.ros.localisation import LocalisationPublisher
from sim_bridge.ros.pacing import Pacer, Schedule, SpeedMeter
from sim_bridge.ros.parameters import PARAMETERS, simulation_options
from sim_bridge.ros.publishers import ClockPublisher, RobotPublisher
from sim_bridge.ros.robot_model import RobotModel
from sim_bridge.ros.world_publishers import MapPublisher, MoverPublisher
from sim_bridge.simulation.world import SimulatedWorld

TICK = 0.005
"""Wall time between two slices of simulation [s]."""
LONGEST_SLICE = 0.02
"""Maximum wall time of a slice [s]; later steps are skipped, so signals and services are never delayed."""
FREE_SLICE = 0.01
"""Maximum wall time of a slice when the world runs as fast as possible [s]."""
LONGEST_STEP = 10.0
"""Maximum simulated time of one StepWorld call [s]."""


class Bridge(SuiteNode):
    """Runs a task's world in a physics engine in place of real robots: publishes sensors, receives commands."""

    PARAMETERS = PARAMETERS

    def __init__(self) -> None:
        super().__init__("sim_bridge")
        settings = self.settings
        self._namespaces = _checked_namespaces(settings["robots"])
        task = load_navigation_task(settings["task"])
        self._world = SimulatedWorld(
            task,
            seed=settings["seed"],
            robots=len(self._namespaces),
            width=settings["corridor_width"] or None,
            options=simulation_options(settings),
        )
        self._rate: int = settings["physics_rate"]
        self._paused: bool = settings["start_paused"]
        self._episode, self._steps_before = 0, 0
        self._refused = 0
        self._pacer, self._meter = Pacer(self._rate), SpeedMeter()
        frames = [Frames(namespace, task.plane) for namespace in self._namespaces]
        models = [RobotModel(each, task) for each in frames]
        transforms = TransformPublisher(self, [fixed for model in models for fixed in model.fixed])
        self._robots = []
        for robot, (each, model) in enumerate(zip(frames, models, strict=True)):
            localisation = LocalisationPublisher(self, self._world, robot, each, settings)
            self._robots.append(RobotPublisher(self, self._world, robot, each, transforms, model, localisation))
        self._map = MapPublisher(self, self._world) if task.plane == "xy" else None
        self._movers = MoverPublisher(self, self._world) if task.movers else None
        self._clock_publisher = ClockPublisher(self, settings["clock_rate"])
        for robot, each in enumerate(frames):
            self._subscribe(robot, each)
        self.create_service(ResetWorld, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(StepWorld, "~/step", self._on_step)
        self._begin_episode()
        self.create_timer(TICK, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(
            f"task '{task.name}' with {len(frames)} robot(s), seed {settings['seed']}, in {self._world.engine}"
        )

    def _subscribe(self, robot: int, frames: Frames) -> None:
        if frames.plane == "xz":
            kind, read = RotorThrusts, _thrusts
        elif self.settings["enable_stamped_cmd_vel"]:
            kind, read = TwistStamped, _stamped_speeds
        else:
            kind, read = Twist, _speeds
        topic = frames.topic("rotor_thrusts" if frames.plane == "xz" else "cmd_vel")
        self.create_subscription(kind, topic, partial(self._on_command, robot, read), COMMAND)

    def _on_command(self, robot: int, read: Callable[[Any], tuple[float, float]], message: Any) -> None:
        if not self._world.command(robot, read(message)):
            self._refused += 1
            self.get_logger().warning("command refused: it is not finite", throttle_duration_sec=5.0)

    def _tick(self) -> None:
        now = time.monotonic()
        if self._paused:
            self._pacer.rest()
        elif self.settings["speed_factor"] == 0.0:
            self._advance(self._rate, now + FREE_SLICE)
        else:
            self._advance(self._pacer.due(now, self.settings["speed_factor"]), now + LONGEST_SLICE)
        self._clock_publisher.publish(time.monotonic(), self._time)

    def _advance(self, steps: int, deadline: float = math.inf) -> None:
        """Step the physics until at most a steady wall time [s], and publish the messages that are due."""
        world = self._world
        end = world.steps + steps
        while world.steps < end and time.monotonic() < deadline:
            world.step(min(end, self._scans.next, self._odometry.next) - world.steps)
            self._publish_due()

    def _publish_due(self) -> None:
        scan, odometry = self._scans.due(self._world.steps), self._odometry.due(self._world.steps)
        for robot in self._robots:
            if odometry:
                robot.publish_odometry(self._time)
                robot.publish_episode(self._time, self._episode)
            if scan:
                robot.publish_scan(self._time)
        if odometry:
            if self._movers is not None:
                self._movers.publish(self._time)
            self._say_how_it_ended()

    def _say_how_it_ended(self) -> None:
        for robot, namespace in enumerate(self._namespaces):
            episode = self._world.episode(robot)
            if episode.outcome is Outcome.RUNNING or robot in self._ended:
                continue
            self._ended.add(robot)
            name = f" of {namespace}" if namespace else ""
            contact = "" if episode.contact is None else f" {episode.contact.words}"
            self.get_logger().info(
                f"episode {self._episode}{name}: {episode.outcome.words}{contact} after {self._world.elapsed:.2f} s, "
                f"closest {episode.smallest_clearance:.3f} m"
            )

    def _begin_episode(self) -> None:
        self._ended: set[int] = set()
        if self._map is not None:
            self._map.publish(self._time)
        for robot in self._robots:
            robot.begin_episode()
        self._scans = Schedule(self._world.lidar.spec.rate, self._rate)
        self._odometry = Schedule(self.settings["odom_rate"], self._rate)
        self._publish_due()

    @property
    def _time(self) -> int:
        """Simulation time since the bridge started [ns], not affected by resets."""
        return (self._steps_before + self._world.steps) * 10**9 // self._rate

    def _on_reset(self, request: ResetWorld.Request, response: ResetWorld.Response) -> ResetWorld.Response:
        steps = self._world.steps
        try:
            self._world.reset(request.seed)
        except CtrlRlError as error:
            response.success, response.message, response.episode = False, str(error), self._episode
            return response
        self._steps_before += steps + 1  # no two messages of a topic may have the same stamp
        self._episode += 1
        self._begin_episode()
        response.success, response.message, response.episode = True, f"episode {self._episode}", self._episode
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused = request.data
        response.success, response.message = True, "paused" if self._paused else "running"
        return response

    def _on_step(self, request: StepWorld.Request, response: StepWorld.Response) -> StepWorld.Response:
        response.success = self._paused and 0.0 < request.duration <= LONGEST_STEP
        if response.success:
            self._advance(max(1, round(request.duration * self._rate)))
            self._clock_publisher.publish(time.monotonic(), self._time)
            response.message = "stepped"
        elif not self._paused:
            response.message = "the world is running: pause it first"
        else:
            response.message = f"duration is {request.duration:g} s: must be more than 0 and at most {LONGEST_STEP:g} s"
        response.stamp = to_stamp(self._time)
        return response

    def status(self) -> Status:
        """Report speed, episode, rejected commands, and messages sent by topic."""
        factor = self._meter.read(time.monotonic(), 1e-9 * self._time)
        wanted = self.settings["speed_factor"]
        values: dict[str, object] = {
            "real_time_factor": round(factor, 3),
            "speed_factor": wanted,
            "simulation_time": round(1e-9 * self._time, 3),
            "paused": str(self._paused).lower(),
            "episode": self._episode,
            "seed": self._world.seed,
            "refused_commands": self._refused,
        }
        for robot in self._robots:
            values |= {f"published.{publisher.topic}": publisher.count for publisher in robot.publishers}
        others = (self._clock_publisher.publisher, *(self._movers.publishers if self._movers else ()))
        values |= {f"published.{publisher.topic}": publisher.count for publisher in others}
        if self._paused:
            return ok("paused", **values)
        if factor < 0.9 * wanted:
            return warn(f"slow: {factor:.2g} of {wanted:g} times real time", **values)
        return ok("running", **values)

    def diagnostics_stamp(self) -> Time:
        """Return the simulation time, which is also used for message stamps."""
        return to_stamp(self._time)

    def stop(self) -> None:
        """Release the physics engine."""
        self._world.close()


def _speeds(message: Twist) -> tuple[float, float]:
    return message.linear.x, message.angular.z


def _stamped_speeds(message: TwistStamped) -> tuple[float, float]:
    return message.twist.linear.x, message.twist.angular.z


def _thrusts(message: RotorThrusts) -> tuple[float, float]:
    return message.t1, message.t2


def _checked_namespaces(names: list[str]) -> list[str]:
    names = list(names) or [""]
    for name in names:
        if name and not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise ParameterError(f"parameter 'robots': '{name}' is no namespace: use letters, digits and _")
    if len(set(names)) < len(names):
        raise ParameterError("parameter 'robots': each namespace may be named once")
    return names


def main() -> int:
    """Run the bridge."""
    return run_node(Bridge)

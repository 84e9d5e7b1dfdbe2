"""Nodes that drive a robot: a driver turns each scan into a command, and a filter checks it.

class MyNode(DriverNode):
    PARAMETERS = (*DRIVER_PARAMETERS, Parameter("speed", 0.1, "Speed [m/s].", 0.0, 1.0))

    def __init__(self) -> None:
        super().__init__("my_node", MyDriver)      # class MyDriver(NodeDriver) with command(sensors)
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from ctrl_rl_core.driving.command_output import ThrustOutput
from ctrl_rl_core.driving.commander import VelocityError
from ctrl_rl_core.driving.drive import Driver, Filter
from ctrl_rl_core.driving.lidar_robot import LIDAR_PARAMETERS, LidarRobot
from ctrl_rl_core.driving.robot_node import RobotNode
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.ros.node import RESULT, Status, seconds
from ctrl_rl_core.ros.parameters import Parameter
from ctrl_rl_core.sensing.scan import ScanGeometry, Sensors
from ctrl_rl_core.tasks.outcome import Outcome
from ctrl_rl_msgs.msg import EpisodeStatus

Array = NDArray[np.float64]

DRIVER_PARAMETERS = (
    *LIDAR_PARAMETERS,
    Parameter("scan_timeout", 0.5, "Age of the last scan or odometry that stops the robot [s].", 0.05, 10.0),
)
MAX_DISTANCE = Parameter(
    "max_distance",
    0.0,
    "Odometry distance after which the robot stops until this parameter is set again [m]; 0.0 for none.",
    0.0,
    1e6,
    live=True,
)
"""For drivers whose drive has an end; they also stop once a simulated episode has an outcome."""
_RECENT = 1000
ENDED = "the drive is over: "
"""Prefix of every reason that `Arrival` returns."""
_LONGEST_STEP_S = 1.0
_NOISE, _LEAP = 0.02, 1.0
"""Position change below which motion may be noise, and above which the odometry origin has jumped [m]."""


class NodeDriver(Driver[Sensors]):
    """A `Driver` that receives additional inputs from its `DriverNode`.

    Attributes:
        limits: Minimum and maximum command (2,), (2,).
        thrusts_at_rest: Hover thrusts of a quadrotor (2,) [N]; None for a wheeled robot.
    """

    limits: tuple[Array, Array]
    thrusts_at_rest: Array | None = None

    def on_sent(self, header: Header, command: Array, problem: str) -> None:
        """Handle a command after it was sent (or suppressed by a dry run); time spent here delays nothing.

        Args:
            header: Header of the scan, or one with the current time if the driver uses no scans.
            command: Speed [m/s] and turn rate [rad/s] (2,).
            problem: Reason why the robot is stopped; empty while it drives.
        """

    def on_odometry(self, message: Odometry) -> None:
        """Process usable odometry."""

    def on_episode(self, message: EpisodeStatus) -> None:
        """Process the state of the simulated episode."""

    def forget(self) -> None:
        """Drop what must not go on when an inactive node is activated again, such as a goal."""

    def use_parameter(self, name: str) -> None:
        """Apply a changed parameter.

        Raises:
            CtrlRlError: The value is invalid.
        """

    def figures(self) -> Mapping[str, object]:
        """Return key figures for `diagnostics`."""
        return {}


class Arrival:
    """Detects the end of a drive: its episode has an outcome, or the distance limit is reached.

    Attributes:
        max_distance: Distance after which the robot stops [m]; 0 for no limit.
        travelled: Distance driven so far [m]: the larger of the pose-based and the twist-based odometry distance.
    """

    def __init__(self, max_distance: float) -> None:
        """Start a drive."""
        self.max_distance = max_distance
        self._outcome = Outcome.RUNNING
        self._episode: int | None = None
        self._last = math.nan
        self._place: tuple[float, float] | None = None
        self.begin()

    def begin(self) -> None:
        """Reset the travelled distance."""
        self.travelled = self._by_pose = self._by_twist = 0.0

    def episode(self, number: int, outcome: int) -> None:
        """Record the number and outcome of an episode, as in EpisodeStatus; a new episode starts a new drive."""
        known = {value.value for value in Outcome}
        new = Outcome(outcome) if outcome in known else Outcome.RUNNING
        if number != self._episode or (new is Outcome.RUNNING and self._outcome is not Outcome.RUNNING):
            self.begin()
        self._episode, self._outcome = number, new

    def moved(self, now: float, speed: float) -> None:
        """Integrate the odometry speed [m/s] at a scan time [s]; gaps longer than one second are skipped."""
        step = now - self._last
        self._last = now
        if 0.0 < step <= _LONGEST_STEP_S and math.isfinite(speed):
            self._by_twist += abs(speed) * step
            self.travelled = max(self._by_pose, self._by_twist)

    def went(self, x: float, y: float) -> None:
        """Add a position from odometry [m]; some bases publish a correct pose with a zero twist."""
        step = math.dist(self._place or (x, y), (x, y))
        if self._place is not None and step < _NOISE:
            return
        self._place = (x, y)
        if step < _LEAP:
            self._by_pose += step
            self.travelled = max(self._by_pose, self._by_twist)

    def reason(self) -> str:
        """Return the reason to stop, or "" while the drive continues."""
        if self._outcome is not Outcome.RUNNING:
            return f"{ENDED}{self._outcome.words} (episode {self._episode})"
        if 0.0 < self.max_distance <= self.travelled:
            return f"{ENDED}{self.max_distance:g} m driven (parameter max_distance; set it again to continue)"
        return ""


class DriverNode(RobotNode):
    """Publishes one command per scan; the robot stops if scan, odometry or decision are unusable.

    Attributes:
        robot: Robot, reached through its topics.
        driver: Driver that turns its scans into commands.
        filter: Filter of the driver's commands; None to use only the robot's own obstacle stop.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = DRIVER_PARAMETERS
    robot: LidarRobot

    def __init__(
        self,
        name: str,
        make_driver: Callable[[DriverNode], NodeDriver],
        filter: Filter[Sensors] | None = None,  # noqa: A002
    ) -> None:
        """Create the node.

        Args:
            name: Name of the node.
            make_driver: Creates the driver from the node, after the settings are read and before the robot is created.
            filter: Filter of the driver's commands.
        """
        super().__init__(name)
        self.driver, self.filter = make_driver(self), filter
        thrusts = self.driver.thrusts_at_rest
        self.robot = robot = LidarRobot(self, output=None if thrusts is None else ThrustOutput(self, thrusts))
        if thrusts is not None:
            robot.limit = robot.limit_by_inputs
        robot.set_limits(*self.driver.limits)
        robot.on_scan, robot.on_odometry, robot.on_stale_input = self._answer, self._keep, self._tell_stale
        self._odometry: Array | None = None
        self._sent = robot.output.rest
        self._latencies: deque[float] = deque(maxlen=_RECENT)
        self._arrival: Arrival | None = None
        if MAX_DISTANCE.name in self.settings:
            self._arrival = Arrival(self.settings[MAX_DISTANCE.name])
            self.create_subscription(EpisodeStatus, "episode", self._on_episode, RESULT)

    def on_parameter_changed(self, name: str) -> None:
        """Apply a changed parameter; setting the distance limit starts a new drive."""
        if name == MAX_DISTANCE.name and self._arrival is not None:
            self._arrival.max_distance = self.settings[name]
            self._arrival.begin()
            return
        self.driver.use_parameter(name)
        self.robot.use_parameter(name)
        self.robot.set_limits(*self.driver.limits)

    def forget(self) -> None:
        """Let the driver drop its goal."""
        self.driver.forget()

    def status(self) -> Status:
        """Report whether commands flow, and their latency; a robot stopped at the end of its drive is healthy."""
        level, message, figures = self.robot.status()
        if self._latencies:
            p50, p99 = np.percentile(self._latencies, (50, 99)) * 1e3
            figures = {**figures, "decision p50 [ms]": f"{p50:.3f}", "decision p99 [ms]": f"{p99:.3f}"}
        if self._arrival is not None:
            if self.robot.problem.startswith(ENDED) and not figures["other publishers"]:
                level = DiagnosticStatus.OK
            figures = {**figures, "driven [m]": f"{self._arrival.travelled:.2f}"}
        return level, message, {**figures, **self.driver.figures()}

    def _answer(self, message: LaserScan, ranges: NDArray[np.float32], scan: ScanGeometry) -> None:
        """Process a scan and send a command."""
        begin, header, robot = time.perf_counter(), message.header, self.robot
        try:
            sent = robot.drive(self._decide(seconds(header.stamp), ranges, scan), header.stamp)
        except CtrlRlError as error:
            robot.halt(str(error), header.stamp)
            self._sent = robot.output.rest
            self.driver.on_sent(header, self._sent, str(error))
            return
        self._sent = sent
        self._latencies.append(time.perf_counter() - begin)
        self.driver.on_sent(header, sent, robot.problem)

    def _decide(self, now: float, ranges: NDArray[np.float32], scan: ScanGeometry) -> Array:
        """Return the command (2,) for a scan received at a time [s].

        Raises:
            CtrlRlError: No command is available: an input is unusable, or the drive has ended.
        """
        if fault := self.robot.input_fault():
            raise VelocityError(fault)
        if self._arrival is not None:
            self._arrival.moved(now, self.robot.motion[0])
            if over := self._arrival.reason():
                raise VelocityError(over)
        assert self._odometry is not None  # guaranteed by the input checks
        sensors = Sensors(ranges, scan, self._odometry, None, None, self._sent, now)
        command = self.driver.command(sensors)
        return command if self.filter is None else self.filter(sensors, command)

    def _keep(self, message: Odometry, odometry: Array) -> None:
        """Store odometry for the next scan, and add its position to the distance driven."""
        self._odometry = odometry
        if self._arrival is not None:
            self._arrival.went(float(odometry[0]), float(odometry[1]))
        self.driver.on_odometry(message)

    def _tell_stale(self, problem: str) -> None:
        """Report that the robot is stopped for lack of scans."""
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self.robot.frame)
        self.driver.on_sent(header, self.robot.output.rest, problem)

    def _on_episode(self, message: EpisodeStatus) -> None:
        """Stop as soon as a simulated episode ends, because the next scan may be late."""
        assert self._arrival is not None
        self._arrival.episode(message.episode, message.outcome.value)
        over = self._arrival.reason()
        if over and self.robot.moving:
            self.robot.halt(over)
        self.driver.on_episode(message)

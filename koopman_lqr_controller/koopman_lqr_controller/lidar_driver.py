"""What every node that drives a robot from its lidar does: listen, decide, command, and stop when in doubt."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections import deque
from typing import ClassVar, NamedTuple

import numpy as np
from builtin_interfaces.msg import Time as Stamp
from ctrl_rl_core.parameters import Parameter
from ctrl_rl_core.ros import COMMAND, SENSOR, Status, SuiteNode, ok, warn
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.time import Time
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.lidar import ScanGeometry

DRIVER_PARAMETERS = (
    Parameter("enable_stamped_cmd_vel", True, "Publish cmd_vel as TwistStamped (Jazzy) instead of Twist (Humble)."),
    Parameter("scan_timeout", 0.5, "Age of the last scan or odometry that stops the robot [s].", 0.05, 10.0),
    Parameter("lidar_yaw", 0.0, "Direction of the scan's zero bearing in the robot's frame [rad].", -3.1416, 3.1416),
    Parameter("base_frame", "base_link", "Frame of the commands."),
    Parameter("dry_run", False, "Decide and say so, but send nothing on cmd_vel.", live=True),
)
_RECENT = 1000
_LAST_WORD = Duration(seconds=0.3)
_STAND = np.zeros(2)


class Sensed(NamedTuple):
    """What a driver knows when it decides: ranges (beams,) [m] and their geometry, speed [m/s], turn rate [rad/s]."""

    ranges: NDArray[np.float32]
    scan: ScanGeometry
    v: float
    omega: float
    header: Header


class LidarDriver(SuiteNode):
    """Publishes one clamped cmd_vel for each scan, zero velocity on stale or unusable input and when it stops.

    In a dry run all is as ever, but nothing is sent.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = DRIVER_PARAMETERS

    def __init__(self, name: str) -> None:
        super().__init__(name)
        stamped: bool = self.settings["enable_stamped_cmd_vel"]
        # One message for all commands: to make one takes as long as to decide.
        self._out = TwistStamped(header=Header(frame_id=self.settings["base_frame"])) if stamped else Twist()
        self._stamp, self._twist = (self._out.header, self._out.twist) if stamped else (Header(), self._out)
        self._publisher = self.create_publisher(type(self._out), "cmd_vel", COMMAND)
        self._odometry: tuple[float, float] | None = None
        # How old things are is no matter of the system's clock, which may be set while the robot drives; a simulation's
        # clock may stand still, and nothing gets old then.
        simulated = self.get_parameter("use_sim_time").value
        self._ages = self.get_clock() if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._odometry_at = self._scan_at = self._ages.now()
        self._counts = {"scans": 0, "commands": 0, "stopped": 0, "stale": 0}
        self._moving = False  # by the last command that was sent
        self._problem = "waiting for scan and odometry"
        self._latencies: deque[float] = deque(maxlen=_RECENT)
        self.create_subscription(Odometry, "odom", self._on_odometry, SENSOR)
        self.create_subscription(LaserScan, "scan", self._on_scan, SENSOR)
        self.create_timer(0.5 * self.settings["scan_timeout"], self._watch, clock=self._ages)

    @abstractmethod
    def decide(self, sensed: Sensed) -> NDArray[np.float64]:
        """Return speed [m/s] and turn rate [rad/s] (2,) for one scan, within the robot's limits.

        Raises:
            KoopmanError: there is no command; the robot then stops, for the reason that the error says.
        """

    def answered(self, header: Header, command: NDArray[np.float64], problem: str) -> None:
        """Take note of what was sent, or in a dry run would have been; nobody waits for it any more.

        Args:
            header: of the scan; where scans stay away, of now.
            command: speed [m/s], turn rate [rad/s] (2,).
            problem: why the robot stands, empty while it drives.
        """

    def setting_changed(self, name: str) -> None:
        """Let the robot stand when a dry run begins: it must not go on with the last command."""
        if name == "dry_run" and self.settings["dry_run"] and self._moving:
            self._send(_STAND, self._now())

    def stop(self) -> None:
        """Leave the robot standing: the zero velocity has arrived before the publisher goes."""
        if not self.settings["dry_run"]:
            self._send(_STAND, self._now())
            self._publisher.wait_for_all_acked(_LAST_WORD)

    def status(self) -> Status:
        """Say whether commands flow, and how quickly."""
        figures: dict[str, object] = dict(self._counts)
        if self._latencies:
            p50, p99 = np.percentile(self._latencies, (50, 99)) * 1e3
            figures |= {"decision p50 [ms]": f"{p50:.3f}", "decision p99 [ms]": f"{p99:.3f}"}
        dry = "dry run, nothing is sent: " if self.settings["dry_run"] else ""
        return warn(f"{dry}{self._problem}", **figures) if self._problem else ok(f"{dry}driving", **figures)

    def _on_odometry(self, message: Odometry) -> None:
        twist = message.twist.twist
        self._odometry = (twist.linear.x, twist.angular.z)
        self._odometry_at = self._ages.now()

    def _on_scan(self, message: LaserScan) -> None:
        begin = time.perf_counter()
        self._counts["scans"] += 1
        self._scan_at = self._ages.now()
        try:
            command = self._command(message)
        except KoopmanError as error:
            self._counts["stopped"] += 1
            self._halt(str(error), message.header)
            return
        if not self.settings["dry_run"]:
            self._counts["commands"] += 1
            self._send(command, message.header.stamp)
        self._latencies.append(time.perf_counter() - begin)
        self._problem = ""
        self.answered(message.header, command, "")

    def _command(self, message: LaserScan) -> NDArray[np.float64]:
        if self._odometry is None or self._age(self._odometry_at) > self.settings["scan_timeout"]:
            raise KoopmanError("no recent odometry")
        command = self.decide(self._sensed(message, *self._odometry))
        if not np.isfinite(command).all():
            raise KoopmanError(f"the policy's command is {command}: not finite")
        return command

    def _sensed(self, message: LaserScan, v: float, omega: float) -> Sensed:
        ranges = np.frombuffer(message.ranges, np.float32)
        bearing = message.angle_min + self.settings["lidar_yaw"]
        scan = ScanGeometry(len(ranges), bearing, message.angle_increment, message.range_min, message.range_max)
        return Sensed(ranges, scan, v, omega, message.header)

    def _watch(self) -> None:
        """Stop the robot when scans stay away."""
        if self._age(self._scan_at) > self.settings["scan_timeout"]:
            self._counts["stale"] += 1
            self._halt("no recent scan", Header(stamp=self._now(), frame_id=self.settings["base_frame"]))

    def _halt(self, problem: str, header: Header) -> None:
        if not self.settings["dry_run"]:
            self._send(_STAND, header.stamp)
        if problem != self._problem:
            self.get_logger().warning(f"stopping: {problem}")
        self._problem = problem
        self.answered(header, _STAND, problem)

    def _age(self, then: Time) -> float:
        return float((self._ages.now() - then).nanoseconds) * 1e-9

    def _now(self) -> Stamp:
        return self.get_clock().now().to_msg()

    def _send(self, command: NDArray[np.float64], stamp: Stamp) -> None:
        self._stamp.stamp = stamp
        self._twist.linear.x, self._twist.angular.z = v, omega = command.tolist()
        self._moving = v != 0.0 or omega != 0.0
        self._publisher.publish(self._out)

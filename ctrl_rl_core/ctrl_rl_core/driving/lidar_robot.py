"""A robot with a lidar, as a component of a node: stops on unusable scans and in front of obstacles.

`drive` sends only the part of a driver's command that is safe according to the last scan.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike, NDArray
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import LaserScan

from ctrl_rl_core.driving.command_output import CommandOutput
from ctrl_rl_core.driving.commander import VELOCITY_PARAMETERS, Commander, VelocityError
from ctrl_rl_core.driving.drive_safety import DriveSafety, ObstacleStop
from ctrl_rl_core.robots.robot import find_robot
from ctrl_rl_core.ros.node import SENSOR, Status, SuiteNode, nanoseconds
from ctrl_rl_core.ros.parameters import ROBOT, Parameter, robot_parameter
from ctrl_rl_core.sensing.live_odometry import LiveOdometry
from ctrl_rl_core.sensing.odometry import OMEGA_Z, OdometryError, V
from ctrl_rl_core.sensing.pose_speeds import NO_TWIST
from ctrl_rl_core.sensing.scan import ScanError, ScanGeometry, read_scan
from ctrl_rl_core.sensing.scan_health import ScanHealth

Array = NDArray[np.float64]
Ranges = NDArray[np.float32]

_SCAN_CHECKS = (
    Parameter(
        "min_echo_share",
        0.3,
        "Minimum fraction of beams with an echo, below which the robot stops; 0.0 to drive in the open.",
        0.0,
        1.0,
        live=True,
    ),
    Parameter(
        "largest_gap",
        2.1,
        "Widest angle without echoes in the direction of travel; the robot stops beyond it; 6.3 for any [rad].",
        0.1,
        6.3,
        live=True,
    ),
    Parameter(
        "frozen_scans",
        2,
        "Number of consecutive identical scans that stop a moving robot; 0 for never.",
        0,
        1000,
        live=True,
    ),
)
_OBSTACLE_STOP = (
    robot_parameter(
        "robot_radius",
        "radius",
        "Radius around base_link that encloses the robot; 0.0 for no obstacle stop [m].",
        0.0,
        5.0,
        live=True,
    ),
    Parameter("obstacle_margin", 0.02, "Additional distance to obstacles [m].", 0.0, 2.0, live=True),
    robot_parameter(
        "deceleration", "plan.braking", "Deceleration of the robot when it brakes [m/s^2].", 0.05, 100.0, live=True
    ),
    Parameter(
        "reaction_time",
        0.3,
        "Time from a scan to the effect of the command for the next scan [s].",
        0.0,
        5.0,
        live=True,
    ),
)
SCAN_PARAMETERS = (
    *VELOCITY_PARAMETERS,
    ROBOT,
    robot_parameter("lidar_x", "lidar.x", "Position of the lidar ahead of base_link [m].", -1.0, 1.0),
    robot_parameter(
        "lidar_yaw", "lidar.yaw", "Direction of the scan's zero bearing in the robot's frame [rad].", -3.1416, 3.1416
    ),
    *_SCAN_CHECKS,
)
"""Parameters without the obstacle stop, for a node with its own collision avoidance."""
LIDAR_PARAMETERS = (*SCAN_PARAMETERS, *_OBSTACLE_STOP)
_CHECKED = {parameter.name for parameter in (*_SCAN_CHECKS, *_OBSTACLE_STOP)}
_FASTER = 1.5
"""Factor by which a robot may exceed its commanded speed."""
_LOOK_AROUND_S = 1.0
"""Time between two checks of the scan's publishers [s]; a query of the graph takes a fraction of a millisecond."""


class LidarRobot(Commander):
    """Receives scans and odometry of a robot with a lidar; sends only commands that the last scan shows to be safe.

    Attributes:
        motion: Odometry speed [m/s] and turn rate [rad/s].
        safety: Checks and echoes of the last scan.
        scans: Number of scans received.
        on_odometry: Called for each usable odometry message, with the message and its values (13,), see
            `ODOMETRY_NAMES`.
        on_scan: Called for each scan, usable or not, with the message, the ranges (beams,) [m], and the bearings and
            limits of the beams in the robot's frame.
        fault: Returns any other reason that forbids motion, or "" for none.
    """

    def __init__(
        self,
        node: SuiteNode,
        timeout: str = "scan_timeout",
        output: CommandOutput | None = None,
        reach: float | None = None,
    ) -> None:
        """Subscribe to scan and odom.

        Args:
            node: Node with `LIDAR_PARAMETERS`, or with `SCAN_PARAMETERS`, without an obstacle stop.
            timeout: Name of the parameter that holds the input timeout [s].
            output: Publisher of the commands; cmd_vel by default.
            reach: Distance from the lidar within which echoes are used [m]; by default that of the obstacle stop.
        """
        super().__init__(node, ("scan", "odometry"), timeout, output)
        self.limit = self.limit_by_scan
        self.motion, self.scans = (0.0, 0.0), 0
        self.on_odometry: Callable[[Odometry, Array], None] = lambda _message, _odometry: None
        self.on_scan: Callable[[LaserScan, Ranges, ScanGeometry], None] = lambda _message, _ranges, _scan: None
        self.fault: Callable[[], str] = lambda: ""
        self._odometry_fault, self._odometry, self._crowd = "", LiveOdometry(), ""
        self._given_reach = reach
        stop = self._obstacle_stop()
        self.safety = DriveSafety(self._scan_health(), stop, self.settings["lidar_x"], self._reach(stop))
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_subscription(Odometry, "odom", self.hear_odometry, SENSOR)
        self._topic: str = node.create_subscription(LaserScan, "scan", self.hear_scan, SENSOR).topic_name
        node.create_timer(_LOOK_AROUND_S, self._look_around, clock=self._steady)

    def input_fault(self) -> str:
        """Return the reason why the inputs forbid motion, or "" if they allow it."""
        return self.stale_input() or self._odometry_fault or self._crowd or self.safety.fault or self.fault()

    def limit_by_scan(self, command: Array) -> tuple[Array, str]:
        """Return the part of a command (2,) that the last scan shows to be safe, and the reason for any reduction.

        Raises:
            VelocityError: No recent scan covers the direction of the command.
        """
        problem = self.input_fault() if command.any() else ""
        if problem:
            raise VelocityError(problem)
        try:
            return self.safety.limit(command, self.motion[0], self.age("scan"))
        except ScanError as error:
            raise VelocityError(str(error)) from None

    def limit_by_inputs(self, command: Array) -> tuple[Array, str]:
        """Return a command (2,) unchanged, for a node without an obstacle stop.

        Raises:
            VelocityError: The inputs forbid motion.
        """
        problem = self.input_fault()
        if problem:
            raise VelocityError(problem)
        return command, ""

    def use_parameter(self, name: str) -> None:
        """Apply a changed parameter; scan checks take effect from the next scan on."""
        if name in _CHECKED:
            stop = self._obstacle_stop()
            self.safety.set_checks(self._scan_health(), stop, self._reach(stop))
        super().use_parameter(name)

    def set_limits(self, low: ArrayLike, high: ArrayLike) -> None:
        """Set the limits of the commands, and the echo range needed at the highest speed."""
        super().set_limits(low, high)
        self.safety.reach = self._reach(self._obstacle_stop())

    def status(self) -> Status:
        """Report whether commands are sent, and the fraction of beams with an echo."""
        level, message, figures = super().status()
        view = self.safety.view
        share = "none" if view is None else f"{100 * view.share:.0f}"
        return level, message, {"scans": self.scans, **figures, "beams with an echo [%]": share}

    def _obstacle_stop(self) -> ObstacleStop:
        """Return the obstacle stop, or None if the node avoids obstacles in its own way."""
        value = self.settings
        if "obstacle_margin" not in value:
            return ObstacleStop(0.0, 0.0, 1.0, 0.0)
        robot = next(each.name for each in self.node.PARAMETERS if each.kind == "robot")  # "body" in a team
        return ObstacleStop(
            value["robot_radius"],
            value["obstacle_margin"],
            value["deceleration"],
            value["reaction_time"],
            find_robot(value[robot]).rectangle,
        )

    def _reach(self, stop: ObstacleStop) -> float:
        """Return the maximum distance from the lidar at which an echo may stop the robot [m]."""
        if self._given_reach is not None:
            return self._given_reach
        top = float(np.abs((self.low[0], self.high[0])).max())
        return stop.radius + stop.margin + abs(self.settings["lidar_x"]) + stop.reach(_FASTER * top, self.timeout)

    def _scan_health(self) -> ScanHealth:
        value = self.settings
        return ScanHealth(value["min_echo_share"], value["largest_gap"], value["frozen_scans"])

    def hear_odometry(self, message: Odometry) -> None:
        """Process odometry; unusable odometry stops the robot."""
        self.use_frame(message.child_frame_id)
        self.note_input("odometry")
        try:
            odometry = self._odometry.read(message)
            if self._odometry.fault:
                raise OdometryError(self._odometry.fault)
        except OdometryError as error:
            self._odometry_fault = str(error)
            self.halt(self._odometry_fault, message.header.stamp)
            return
        if self._odometry.lacks_twist:
            self.node.get_logger().warning(f"odometry: {NO_TWIST}", once=True)
        self.motion, self._odometry_fault = (float(odometry[V]), float(odometry[OMEGA_Z])), ""
        self.on_odometry(message, odometry)

    def hear_scan(self, message: LaserScan) -> None:
        """Read a scan, update the checks and pass the scan on."""
        self.scans += 1
        self.note_input("scan")
        ranges, scan = read_scan(message, self.settings["lidar_yaw"])
        stamp, now = nanoseconds(message.header.stamp), self._steady.now().nanoseconds * 1e-9
        self.safety.update(now, stamp, message.header.frame_id, ranges, scan, self.motion)
        self.on_scan(message, ranges, scan)

    def _look_around(self) -> None:
        """Check that exactly one lidar publishes scans."""
        count = self.node.count_publishers(self._topic)
        self._crowd = f"{count} publishers on {self._topic}: there must be one lidar" if count > 1 else ""

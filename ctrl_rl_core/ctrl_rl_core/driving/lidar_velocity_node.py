"""Base class of nodes that drive a robot by lidar: it stops the robot on unusable scans and in front of obstacles.

Whatever a policy commands, `drive` sends only the part that is safe by the last scan.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike, NDArray
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import LaserScan

from ctrl_rl_core.driving.drive_safety import DriveSafety
from ctrl_rl_core.driving.obstacle_stop import ObstacleStop
from ctrl_rl_core.driving.velocity_node import VELOCITY_PARAMETERS, VelocityError, VelocityNode
from ctrl_rl_core.ros.node import SENSOR, Status, nanoseconds
from ctrl_rl_core.ros.parameters import ROBOT, Parameter, robot_parameter
from ctrl_rl_core.sensing.odometry import OdometryError, read_odometry
from ctrl_rl_core.sensing.odometry_health import OdometryHealth
from ctrl_rl_core.sensing.scan import ScanError, ScanGeometry, read_scan
from ctrl_rl_core.sensing.scan_health import ScanHealth

_SCAN_CHECKS = (
    Parameter(
        "min_echo_share",
        0.3,
        "Least share of beams with an echo; the robot stops below it; 0.0 to drive in the open.",
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
        "Number of identical scans in a row that stop a moving robot; 0 for never.",
        0,
        1000,
        live=True,
    ),
)
_OBSTACLE_STOP = (
    robot_parameter(
        "robot_radius",
        "radius",
        "Radius around base_link that holds all of the robot; 0.0 for no obstacle stop [m].",
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
        "Time from a scan to the effect of the command that answers the next scan [s].",
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
"""Parameters without those of the obstacle stop, for a node that keeps clear of obstacles in its own way."""
LIDAR_PARAMETERS = (*SCAN_PARAMETERS, *_OBSTACLE_STOP)
_CHECKED = {parameter.name for parameter in (*_SCAN_CHECKS, *_OBSTACLE_STOP)}
_FASTER = 1.5
"""A robot may be faster than its commands by this factor."""
_LOOK_AROUND_S = 1.0
"""Time between two checks of the scan's publishers [s]; a query of the graph takes a fraction of a millisecond."""


class LidarVelocityNode(VelocityNode):
    """Subscribes to scan and odom; sends only commands that are safe by the last scan.

    A class that derives from it takes `on_odometry` and `on_scan`, and calls `drive` in one of them.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = LIDAR_PARAMETERS

    def __init__(self, name: str) -> None:
        super().__init__(name, needs=("scan", "odometry"))
        self.motion = (0.0, 0.0)
        self._odometry_fault, self._odometry_health = "", OdometryHealth()
        self._received = 0
        self._crowd = ""
        self._safety = DriveSafety(
            self._scan_health(), self.obstacle_stop(), forward=self.settings["lidar_x"], reach=self.reach()
        )
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_subscription(Odometry, "odom", self._on_odometry, SENSOR)
        self._scans = self.create_subscription(LaserScan, "scan", self._on_scan, SENSOR)
        self.create_timer(_LOOK_AROUND_S, self._look_around, clock=self._steady)

    def on_odometry(self, message: Odometry, odometry: NDArray[np.float64]) -> None:
        """Act on odometry, also as numbers (13,), see `ODOMETRY_NAMES`; override it where it matters."""

    def on_scan(self, message: LaserScan, ranges: NDArray[np.float32], scan: ScanGeometry) -> None:
        """Act on a scan, usable or not; `drive` refuses to move by an unusable one. Override it where it matters.

        Args:
            message: Scan as it was received.
            ranges: Ranges of the beams (scan.beams,) [m].
            scan: Bearings and limits of the beams in the robot's frame.
        """

    def input_fault(self) -> str:
        """Return why scan or odometry allow no motion; empty where they do."""
        return self.stale_input() or self._odometry_fault or self._crowd or self._safety.fault

    def make_safe(self, command: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
        """Return the safe part of a command (2,) by the last scan, and the reason where it is less than the whole.

        Raises:
            VelocityError: No recent scan covers the direction of the command.
        """
        problem = self.input_fault() if command.any() else ""
        if problem:
            raise VelocityError(problem)
        try:
            return self._safety.limit(command, self.motion[0], self.age("scan"))
        except ScanError as error:
            raise VelocityError(str(error)) from None

    def on_parameter_changed(self, name: str) -> None:
        """Apply changed checks from the next scan on."""
        if name in _CHECKED:
            self._safety.set_checks(self._scan_health(), self.obstacle_stop(), reach=self.reach())
        else:
            super().on_parameter_changed(name)

    def status(self) -> Status:
        """Return whether commands are sent, and the share of beams with an echo."""
        level, message, figures = super().status()
        view = self._safety.view
        share = "none" if view is None else f"{100 * view.share:.0f}"
        return level, message, {"scans": self._received, **figures, "beams with an echo [%]": share}

    def set_limits(self, low: ArrayLike, high: ArrayLike) -> None:
        """Set the limits of the commands, and the range of echoes that the fastest of them needs."""
        super().set_limits(low, high)
        self._safety.reach = self.reach()

    def obstacle_stop(self) -> ObstacleStop:
        """Return the stop in front of obstacles; override it for a node that keeps clear of them in its own way."""
        value = self.settings
        return ObstacleStop(
            value["robot_radius"], value["obstacle_margin"], value["deceleration"], value["reaction_time"]
        )

    def reach(self) -> float:
        """Return the distance from the lidar at which an echo may stop the robot [m]."""
        obstacles = self.obstacle_stop()
        top = float(np.abs((self.low[0], self.high[0])).max())
        wide = obstacles.radius + obstacles.margin + abs(self.settings["lidar_x"])
        return wide + obstacles.reach(_FASTER * top, self.timeout)

    def _scan_health(self) -> ScanHealth:
        value = self.settings
        return ScanHealth(value["min_echo_share"], value["largest_gap"], value["frozen_scans"])

    def _on_odometry(self, message: Odometry) -> None:
        self.use_frame(message.child_frame_id)
        self.note_input("odometry")
        try:
            odometry = read_odometry(message)
            contradiction = self._odometry_health.update(nanoseconds(message.header.stamp), odometry)
            if contradiction:
                raise OdometryError(contradiction)
        except OdometryError as error:
            self._odometry_fault = str(error)
            self.halt(self._odometry_fault, message.header.stamp)
            return
        self.motion, self._odometry_fault = (float(odometry[7]), float(odometry[12])), ""
        self.on_odometry(message, odometry)

    def _on_scan(self, message: LaserScan) -> None:
        self._received += 1
        self.note_input("scan")
        ranges, scan = read_scan(message, self.settings["lidar_yaw"])
        stamp, now = nanoseconds(message.header.stamp), self._steady.now().nanoseconds * 1e-9
        self._safety.update(now, stamp, message.header.frame_id, ranges, scan, self.motion)
        self.on_scan(message, ranges, scan)

    def _look_around(self) -> None:
        """Check that one lidar alone publishes scans."""
        count = self.count_publishers(self._scans.topic_name)
        self._crowd = f"{count} publishers on {self._scans.topic_name}: there must be one lidar" if count > 1 else ""

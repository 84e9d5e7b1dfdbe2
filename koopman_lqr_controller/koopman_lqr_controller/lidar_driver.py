"""What every node does that answers each scan of a lidar with a command."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections import deque
from typing import ClassVar, NamedTuple

import numpy as np
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.parameters import Parameter
from ctrl_rl_core.ros import SENSOR, Status
from ctrl_rl_core.velocity_node import VELOCITY_PARAMETERS, VelocityError, VelocityNode
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from koopman_lqr_controller.lidar import ScanGeometry

DRIVER_PARAMETERS = (
    *VELOCITY_PARAMETERS,
    Parameter("scan_timeout", 0.5, "Age of the last scan or odometry that stops the robot [s].", 0.05, 10.0),
    Parameter("lidar_yaw", 0.0, "Direction of the scan's zero bearing in the robot's frame [rad].", -3.1416, 3.1416),
)
_RECENT = 1000
_STAND = np.zeros(2)


class Sensed(NamedTuple):
    """What a driver knows when it decides: ranges (beams,) [m] and their geometry, speed [m/s], turn rate [rad/s]."""

    ranges: NDArray[np.float32]
    scan: ScanGeometry
    v: float
    omega: float
    header: Header


class LidarDriver(VelocityNode):
    """Publishes one cmd_vel for each scan, zero velocity where the scan, the odometry or the decision is unfit."""

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = DRIVER_PARAMETERS

    def __init__(self, name: str) -> None:
        super().__init__(name, needs=("scan", "odometry"))
        self._speeds = (0.0, 0.0)
        self._scans = 0
        self._latencies: deque[float] = deque(maxlen=_RECENT)
        self.create_subscription(Odometry, "odom", self._on_odometry, SENSOR)
        self.create_subscription(LaserScan, "scan", self._on_scan, SENSOR)

    @abstractmethod
    def decide(self, sensed: Sensed) -> NDArray[np.float64]:
        """Return speed [m/s] and turn rate [rad/s] (2,) for one scan.

        Raises:
            CtrlRlError: there is no command; the robot then stops, for the reason that the error says.
        """

    def answered(self, header: Header, command: NDArray[np.float64], problem: str) -> None:
        """Take note of what was sent, or in a dry run would have been; nobody waits for it any more.

        Args:
            header: header of the scan; where scans stay away, of now.
            command: speed [m/s], turn rate [rad/s] (2,).
            problem: why the robot stands, empty while it drives.
        """

    def status(self) -> Status:
        """Say whether commands flow, and how quickly."""
        level, message, figures = super().status()
        figures = {"scans": self._scans, **figures}
        if self._latencies:
            p50, p99 = np.percentile(self._latencies, (50, 99)) * 1e3
            figures |= {"decision p50 [ms]": f"{p50:.3f}", "decision p99 [ms]": f"{p99:.3f}"}
        return level, message, figures

    def stale(self, problem: str) -> None:
        """Say that there was nothing to answer."""
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self.frame)
        self.answered(header, _STAND, problem)

    def _on_odometry(self, message: Odometry) -> None:
        twist = message.twist.twist
        self._speeds = (twist.linear.x, twist.angular.z)
        self.robot_frame(message.child_frame_id)
        self.heard("odometry")

    def _on_scan(self, message: LaserScan) -> None:
        begin = time.perf_counter()
        self._scans += 1
        self.heard("scan")
        try:
            problem = self.missing()
            if problem:
                raise VelocityError(problem)
            command = self.drive(self.decide(self._sensed(message)), message.header.stamp)
        except CtrlRlError as error:
            self.stand(str(error), message.header.stamp)
            self.answered(message.header, _STAND, str(error))
            return
        self._latencies.append(time.perf_counter() - begin)
        self.answered(message.header, command, "")

    def _sensed(self, message: LaserScan) -> Sensed:
        ranges = np.frombuffer(message.ranges, np.float32)
        bearing = message.angle_min + self.settings["lidar_yaw"]
        scan = ScanGeometry(len(ranges), bearing, message.angle_increment, message.range_min, message.range_max)
        return Sensed(ranges, scan, *self._speeds, message.header)

"""What every node does that answers each scan of a lidar with a command."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections import deque
from typing import ClassVar, NamedTuple

import numpy as np
from ctrl_rl_core.driving.lidar_velocity_node import LIDAR_PARAMETERS, LidarVelocityNode
from ctrl_rl_core.driving.scan import ScanGeometry
from ctrl_rl_core.driving.velocity_node import VelocityError
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.ros.node import Status
from ctrl_rl_core.ros.parameters import Parameter
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

DRIVER_PARAMETERS = (
    *LIDAR_PARAMETERS,
    Parameter("scan_timeout", 0.5, "Age of the last scan or odometry that stops the robot [s].", 0.05, 10.0),
)
_RECENT = 1000
_STAND = np.zeros(2)


class SensorReading(NamedTuple):
    """What a driver knows when it decides: ranges (beams,) [m] and their geometry, speed [m/s], turn rate [rad/s]."""

    ranges: NDArray[np.float32]
    scan: ScanGeometry
    v: float
    omega: float
    header: Header


class LidarDriver(LidarVelocityNode):
    """Publishes one cmd_vel for each scan, zero velocity where the scan, the odometry or the decision is unfit."""

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = DRIVER_PARAMETERS

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._latencies: deque[float] = deque(maxlen=_RECENT)

    @abstractmethod
    def decide(self, reading: SensorReading) -> NDArray[np.float64]:
        """Return speed [m/s] and turn rate [rad/s] (2,) for one scan.

        Raises:
            CtrlRlError: there is no command; the robot then stops, for the reason that the error says.
        """

    def on_command_sent(self, header: Header, command: NDArray[np.float64], problem: str) -> None:
        """Take note of what was sent, or in a dry run would have been; nobody waits for it any more.

        Args:
            header: header of the scan; where scans stay away, of now.
            command: speed [m/s], turn rate [rad/s] (2,).
            problem: why the robot stands, empty while it drives.
        """

    def status(self) -> Status:
        """Say whether commands flow, and how quickly."""
        level, message, figures = super().status()
        if self._latencies:
            p50, p99 = np.percentile(self._latencies, (50, 99)) * 1e3
            figures = {**figures, "decision p50 [ms]": f"{p50:.3f}", "decision p99 [ms]": f"{p99:.3f}"}
        return level, message, figures

    def on_stale_input(self, problem: str) -> None:
        """Say that there was nothing to answer."""
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self.frame)
        self.on_command_sent(header, _STAND, problem)

    def on_scan(self, message: LaserScan, ranges: NDArray[np.float32], scan: ScanGeometry) -> None:
        """Answer it."""
        begin = time.perf_counter()
        try:
            problem = self.input_fault()
            if problem:
                raise VelocityError(problem)
            reading = SensorReading(ranges, scan, *self.motion, message.header)
            command = self.drive(self.decide(reading), message.header.stamp)
        except CtrlRlError as error:
            self.halt(str(error), message.header.stamp)
            self.on_command_sent(message.header, _STAND, str(error))
            return
        self._latencies.append(time.perf_counter() - begin)
        self.on_command_sent(message.header, command, self.problem)

"""The base of nodes that answer each scan of a lidar with one velocity command."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections import deque
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from ctrl_rl_core.driving.lidar_velocity_node import LIDAR_PARAMETERS, LidarVelocityNode
from ctrl_rl_core.driving.velocity_node import VelocityError
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.ros.node import Status
from ctrl_rl_core.ros.parameters import Parameter
from ctrl_rl_core.sensing.scan import ScanGeometry

DRIVER_PARAMETERS = (
    *LIDAR_PARAMETERS,
    Parameter("scan_timeout", 0.5, "Age of the last scan or odometry that stops the robot [s].", 0.05, 10.0),
)
_RECENT = 1000


class SensorReading(NamedTuple):
    """Input of one decision.

    Attributes:
        ranges: Distances of the scan's beams (beams,) [m].
        scan: Geometry of the scan.
        v: Speed by odometry [m/s].
        omega: Turn rate by odometry [rad/s].
        header: Header of the scan.
    """

    ranges: NDArray[np.float32]
    scan: ScanGeometry
    v: float
    omega: float
    header: Header


class PendingDecision(NamedTuple):
    """Decision about one scan, until its command is sent.

    Attributes:
        command: Speed [m/s] and turn rate [rad/s] (2,).
        details: Facts of the decision that `on_command_sent` gets back.
        stop: Reason why the robot must stand in spite of the command; empty where it may drive.
    """

    command: NDArray[np.float64]
    details: Any = None
    stop: str = ""


class LidarDriver(LidarVelocityNode):
    """Publishes one cmd_vel for each scan, zero velocity where the scan, the odometry or the decision is unfit."""

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = DRIVER_PARAMETERS

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._latencies: deque[float] = deque(maxlen=_RECENT)

    @abstractmethod
    def decide(self, reading: SensorReading) -> PendingDecision:
        """Return the decision about one scan.

        Raises:
            CtrlRlError: there is no command; the robot then stops, for the reason that the error says.
        """

    def on_command_sent(self, header: Header, command: NDArray[np.float64], problem: str, details: Any) -> None:
        """Note a command after it was sent, or would have been in a dry run; nobody waits for it any more.

        Args:
            header: Header of the scan; without scans, one with the present time.
            command: Speed [m/s] and turn rate [rad/s] (2,).
            problem: Reason why the robot stands; empty while it drives.
            details: Details of the decision; None where nothing was decided.
        """

    def status(self) -> Status:
        """Return whether commands flow, and how quickly."""
        level, message, figures = super().status()
        if self._latencies:
            p50, p99 = np.percentile(self._latencies, (50, 99)) * 1e3
            figures = {**figures, "decision p50 [ms]": f"{p50:.3f}", "decision p99 [ms]": f"{p99:.3f}"}
        return level, message, figures

    def on_stale_input(self, problem: str) -> None:
        """Report that the robot stands without a scan to answer."""
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self.frame)
        self.on_command_sent(header, self.output.rest, problem, None)

    def on_scan(self, message: LaserScan, ranges: NDArray[np.float32], scan: ScanGeometry) -> None:
        """Answer the scan with a command."""
        begin = time.perf_counter()
        details: Any = None
        try:
            fault = self.input_fault()
            if fault:
                raise VelocityError(fault)
            pending = self.decide(SensorReading(ranges, scan, *self.motion, message.header))
            details = pending.details
            if pending.stop:
                raise VelocityError(pending.stop)
            command = self.drive(pending.command, message.header.stamp)
        except CtrlRlError as error:
            self.halt(str(error), message.header.stamp)
            self.on_command_sent(message.header, self.output.rest, str(error), details)
            return
        self._latencies.append(time.perf_counter() - begin)
        self.on_command_sent(message.header, command, self.problem, details)

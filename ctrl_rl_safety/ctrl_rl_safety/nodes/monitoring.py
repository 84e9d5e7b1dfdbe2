"""Connect the safety filter with the robot's monitor, which gets the node's inputs and outputs and sets the bounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from ctrl_rl_core.sensing import OMEGA_Z, V
from numpy.typing import NDArray

from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.filter.safety_filter import SafetyFilter
from ctrl_rl_safety.filter.verdict import Reading
from ctrl_rl_safety.monitor.robot_monitor import RobotMonitor

Array = NDArray[np.float64]


class Monitoring:
    """A filter with the optional monitor of its robot.

    Args:
        safety: Filter that uses the bounds.
        settings: Values of `FILTER_PARAMETERS`.

    Attributes:
        fault: Reason why the robot must stop; empty if there is none.
    """

    def __init__(self, safety: SafetyFilter, settings: Mapping[str, Any]) -> None:
        self._safety, self._settings, self.fault = safety, settings, ""
        self._monitor: RobotMonitor | None = None
        if settings["monitor"]:
            unproven = settings["unproven_braking"], settings["unproven_delay"]
            self._monitor = RobotMonitor(safety.model, settings["lidar_x"], *unproven)

    def sent(self, now: float, command: Array) -> None:
        """Record a command (2,) [m/s, rad/s] that was sent at a steady time [s]."""
        self._safety.sent(now, command)
        if self._monitor is not None:
            self._monitor.motion.sent(now, command)

    def forget(self) -> None:
        """Restart because the odometry frame has jumped."""
        self._safety.forget()
        if self._monitor is not None:
            self._monitor.forget()

    def measure(self, now: float, reading: Reading, odometry: Array) -> None:
        """Compare the motion with the model, and update the filter's bounds.

        Args:
            now: Steady time [s].
            reading: Pose and age of the odometry.
            odometry: Values of the message (13,), see `ODOMETRY_NAMES`.
        """
        monitor = self._monitor
        if monitor is None or self._settings["dry_run"]:  # another node commands the robot
            return
        monitor.motion.measure(now - reading.age, reading.pose, float(odometry[V]), float(odometry[OMEGA_Z]))
        self.fault = monitor.problem
        try:
            self._safety.adopt(monitor.model, monitor.soonest)
        except SafetyError as error:
            self.fault = str(error)

    def look(self, pose: Array, echoes: Array) -> None:
        """Compare a scan with earlier ones, see `Mounting.look`."""
        if self._monitor is not None:
            self._monitor.mounting.look(pose, echoes)

    def words(self) -> str:
        """Describe the bounds that have grown; empty if none has."""
        return "" if self._monitor is None else self._monitor.words()

    def figures(self) -> dict[str, str]:
        """Return the bounds that have grown, for diagnostics."""
        return {} if self._monitor is None else self._monitor.figures()

"""The safety filter between a driver and a robot: takes sensor readings and a command, returns a certified command."""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.sensing import planar, view_scan
from numpy.typing import NDArray

from ctrl_rl_core import Sensors
from ctrl_rl_safety.filter.evidence import beams_of
from ctrl_rl_safety.filter.map_walls import MapWalls
from ctrl_rl_safety.filter.safety_filter import SafetyFilter
from ctrl_rl_safety.filter.verdict import Mode, Reading, Verdict
from ctrl_rl_safety.monitor.robot_monitor import RobotMonitor

Array = NDArray[np.float64]

_ROUNDING_S = 1e-6


class SensorFilter:
    """A `ctrl_rl_core` `Filter` that processes each new scan and answers each command.

    Args:
        safety: Filter that has not processed any scan.
        lidar_x: Position of the lidar ahead of the robot's centre [m].
        set_period: Interval between solutions of the recoverable set, each for the last scan [s]; 0 to solve for each
            scan, infinite for no set.
        walls: Map in whose frame the sensors' pose is given, or None.
        monitor: Monitor of the same robot, whose bounds the filter uses from now on; None to trust the model.

    Attributes:
        looks: Whether the filter needs every scan of the lidar: always.
        changed: Whether the last answer differed from the raw command.
        verdict: Answer to the last command; None before the first.
    """

    def __init__(
        self,
        safety: SafetyFilter,
        lidar_x: float,
        set_period: float = 0.0,
        walls: MapWalls | None = None,
        monitor: RobotMonitor | None = None,
    ) -> None:
        self._safety, self._lidar_x, self._set_period, self._walls = safety, lidar_x, set_period, walls
        self._monitor = monitor
        self._solved_at = -math.inf
        self.looks, self.changed = True, False
        self.verdict: Verdict | None = None

    def __call__(self, sensors: Sensors, command: Array) -> Array:
        """Return the certified command nearest to a raw one (2,)."""
        safety, now = self._safety, sensors.time
        pose = planar(sensors.odometry[:7].tolist())
        if sensors.age == 0.0:
            reach = safety.reach + abs(self._lidar_x)
            points = view_scan(sensors.ranges, sensors.scan, reach, self._lidar_x).points
            fixed = None
            if self._walls is not None and sensors.pose is not None:
                fixed = self._walls.fixed(sensors.pose, pose)
            beams = beams_of(sensors.ranges, sensors.scan, self._lidar_x)
            safety.see(now, pose, points, fixed=fixed, beams=beams)
            if self._monitor is not None:
                self._monitor.mounting.look(pose, points)
            if self._set_period < math.inf and now - self._solved_at >= self._set_period - _ROUNDING_S:
                self._solved_at = now
                safety.use(safety.solve())
        if self._monitor is not None:
            self._monitor.motion.measure(now, pose, *sensors.speeds)
            safety.adopt(self._monitor.model, self._monitor.soonest)
        verdict = safety.decide(now, Reading(pose, *sensors.speeds), command)
        sent = verdict.command
        if self._monitor is not None:
            if self._monitor.problem:
                sent = safety.stopping(now)
            self._monitor.motion.sent(now, sent)
        safety.sent(now, sent)
        self.verdict, self.changed = verdict, verdict.mode is not Mode.PASSED or sent is not verdict.command
        return sent

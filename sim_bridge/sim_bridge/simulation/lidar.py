"""A planar lidar: ray casts, noise and drop-out; ranges by REP-117, or as TurtleBot3 drivers write them.

In REP-117, +inf means nothing within reach, -inf something too close to measure, and NaN a lost beam.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.tasks import LidarSpec
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry
from sim_bridge.engines.engine import Engine

LOST_BEAM = {"nan": np.nan, "inf": np.inf, "zero": 0.0}
"""Readings of a lost beam by name; the LDS-01 of the burger writes 0."""
LIDARS = ("task", "lds01", "lds02")
"""The task's own by REP-117; an LDS-01: zero for whatever is not measured; an LDS-02: NaN for it, a count of beams that
varies with the motor's speed, and a claim to measure from 0 to 100 m."""

_LDS02_BEAMS = (267.0, 274.0)
_LDS02_REACH = (0.16, 8.0)
_LDS02_CLAIM = (0.0, 100.0)


@dataclass(frozen=True)
class SensorPose:
    """Position of a lidar, and the plane it scans.

    Attributes:
        origin: Position of the lidar (3,) [m].
        axes: (2, 3) unit vectors: bearing 0, and bearing 90 deg.
    """

    origin: NDArray[np.float64]
    axes: NDArray[np.float64]


@dataclass(frozen=True)
class LidarScan:
    """One scan, with the fields of sensor_msgs/LaserScan.

    Attributes:
        ranges: Measured distances (beams,) [m].
        angle_min: Bearing of the first beam [rad].
        angle_increment: Angle between beams [rad].
        range_min: Minimum distance that the driver claims to measure [m].
        range_max: Maximum distance that it claims [m].
        yaw: Direction of its zero bearing in the robot's frame [rad].
    """

    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    yaw: float = 0.0

    @property
    def geometry(self) -> ScanGeometry:
        """Bearings and limits of the beams in the robot's frame."""
        ranges = self.range_min, self.range_max
        return ScanGeometry(len(self.ranges), self.angle_min + self.yaw, self.angle_increment, *ranges)


class Lidar:
    """The beams of a task's lidar, or of a real one in its place.

    Attributes:
        spec: Lidar of the task.
        kind: One of `LIDARS`.
        noise: Standard deviation of a range [m].
        dropout: Probability that a beam is lost.
        bearings: Bearings of the task's beams (n,) [rad].
    """

    def __init__(self, spec: LidarSpec, lost_beam: str = "nan", kind: str = "task") -> None:
        self.spec, self.kind = spec, kind
        self.set_errors(None, None)
        bearings = spec.angle_min + spec.angle_increment * np.arange(spec.beams)
        self.bearings = np.asarray(bearings, dtype=np.float64)
        self._lost = LOST_BEAM[lost_beam]

    def set_errors(self, noise: float | None, dropout: float | None) -> None:
        """Set the standard deviation of a range [m] and the probability that a beam is lost; None for the task's."""
        self.noise = self.spec.noise if noise is None else noise
        self.dropout = self.spec.dropout if dropout is None else dropout

    def scan(
        self, engine: Engine, frame: SensorPose, robot: int, random: np.random.Generator, buried: bool = False
    ) -> LidarScan:
        """Return one scan.

        Args:
            engine: World to scan.
            frame: Frame of the sensor.
            robot: Number of the robot that carries it, which it ignores.
            random: Source of noise, drop-out, and a varying number of beams.
            buried: Whether the sensor is inside a shape, so that all beams are too close.
        """
        bearings, increment, (least, largest) = self._beams(random)
        if buried:
            ranges = np.zeros(len(bearings))
        else:
            reach = largest * np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
            free = engine.cast(frame.origin, frame.origin + reach @ frame.axes, robot)
            ranges = np.where(free < 1.0, free * largest, np.inf)
        # Drawn whether used or not: two noise levels with the same seed then differ by scale alone.
        error, lot = random.standard_normal(len(bearings)), random.random(len(bearings))
        ranges += self.noise * error
        ranges[ranges > largest] = np.inf
        ranges[ranges < least] = -np.inf
        lost, claim = self._lost, (least, largest)
        if self.kind != "task":
            lost = np.nan if self.kind == "lds02" else 0.0
            ranges[np.isinf(ranges)] = lost
        if self.kind == "lds02":
            claim = _LDS02_CLAIM
        ranges[lot < self.dropout] = lost
        return LidarScan(ranges.astype(np.float32), float(bearings[0]), increment, *claim)

    def _beams(self, random: np.random.Generator) -> tuple[NDArray[np.float64], float, tuple[float, float]]:
        """Return the bearings of this scan, their increment, and its range limits."""
        if self.kind != "lds02":
            return self.bearings, self.spec.angle_increment, (self.spec.range.low, self.spec.range.high)
        count = random.uniform(*_LDS02_BEAMS)  # the increment follows the motor's speed, the count the increment
        increment = 2.0 * np.pi / count
        bearings = np.asarray(increment * np.arange(int(np.ceil(count))), dtype=np.float64)
        return bearings, increment, _LDS02_REACH

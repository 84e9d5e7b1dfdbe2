"""A planar lidar: ray casts, noise and drop-out; ranges follow REP-117 or the TurtleBot3 drivers.

In REP-117, +inf means no echo within range, -inf an object too close to measure, and NaN a lost beam.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.tasks import LidarSpec
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry
from sim_bridge.engines.engine import Engine

LOST_BEAM = {"nan": np.nan, "inf": np.inf, "zero": 0.0}
"""Values of a lost beam by name; the LDS-01 of the burger writes 0."""
LIDARS = ("task", "lds01", "lds02")
"""Lidar kinds: the task's own, an LDS-01, or an LDS-02.

The task's own follows REP-117. The LDS-01 writes zero for missing measurements. The LDS-02 writes NaN for them, has a
beam count that varies with the motor speed, and claims a range of 0 to 100 m.
"""

_LDS02_BEAMS = (267.0, 274.0)
_LDS02_REACH = (0.16, 8.0)
_LDS02_CLAIM = (0.0, 100.0)


@dataclass(frozen=True)
class SensorPose:
    """Position of a lidar and its scan plane.

    Attributes:
        origin: Position of the lidar (3,) [m].
        axes: Unit vectors of bearings 0 and 90 deg (2, 3).
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
        range_min: Minimum distance stated by the driver [m].
        range_max: Maximum distance stated by the driver [m].
        yaw: Direction of the zero bearing in the robot's frame [rad].
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
    """The task's lidar, or a real lidar model in its place.

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
        """Set the range noise (standard deviation) [m] and the beam loss probability; None for the task's values."""
        self.noise = self.spec.noise if noise is None else noise
        self.dropout = self.spec.dropout if dropout is None else dropout

    def scan(
        self, engine: Engine, frame: SensorPose, robot: int, random: np.random.Generator, buried: bool = False
    ) -> LidarScan:
        """Take one scan.

        Args:
            engine: World to scan.
            frame: Frame of the sensor.
            robot: Index of the robot that carries the lidar, which the rays ignore.
            random: Random generator for noise, drop-out and the number of beams.
            buried: Whether the sensor is inside a shape, which makes all beams too close.
        """
        bearings, increment, (least, largest) = self._beams(random)
        if buried:
            ranges = np.zeros(len(bearings))
        else:
            reach = largest * np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
            free = engine.cast(frame.origin, frame.origin + reach @ frame.axes, robot)
            ranges = np.where(free < 1.0, free * largest, np.inf)
        # Always drawn, so that two noise levels with the same seed differ only in scale.
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
        """Return the bearings of this scan, their increment, and the range limits."""
        if self.kind != "lds02":
            return self.bearings, self.spec.angle_increment, (self.spec.range.low, self.spec.range.high)
        count = random.uniform(*_LDS02_BEAMS)  # the increment follows the motor's speed, and the count the increment
        increment = 2.0 * np.pi / count
        bearings = np.asarray(increment * np.arange(int(np.ceil(count))), dtype=np.float64)
        return bearings, increment, _LDS02_REACH

"""A planar lidar: ray casts, noise and drop-out; ranges as REP-117 wants them.

+inf: nothing within reach. -inf: something nearer than can be measured. NaN: the beam was lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.task_parts import LidarSpec
from numpy.typing import NDArray

from sim_bridge.physics import Physics

LOST_BEAM = {"nan": np.nan, "inf": np.inf, "zero": 0.0}
"""What a driver may write for a lost beam; the LDS-01 of the burger writes 0."""


@dataclass(frozen=True)
class SensorFrame:
    """Where a lidar is, and the plane it turns in.

    Attributes:
        origin: (3,) [m].
        axes: (2, 3) unit vectors: bearing 0, and bearing 90 deg.
    """

    origin: NDArray[np.float64]
    axes: NDArray[np.float64]


class Lidar:
    """The beams of a task's lidar.

    Attributes:
        spec: the task's.
        noise: standard deviation of a range [m].
        dropout: probability that a beam is lost.
        bearings: of the beams (n,) [rad].
    """

    def __init__(
        self, spec: LidarSpec, noise: float | None = None, dropout: float | None = None, lost_beam: str = "nan"
    ) -> None:
        self.spec = spec
        self.noise = spec.noise if noise is None else noise
        self.dropout = spec.dropout if dropout is None else dropout
        self.bearings = spec.angle_min + spec.angle_increment * np.arange(spec.beams)
        self._reach = spec.range.high * np.stack((np.cos(self.bearings), np.sin(self.bearings)), axis=1)
        self._lost = LOST_BEAM[lost_beam]

    def scan(
        self, physics: Physics, frame: SensorFrame, mask: int, random: np.random.Generator, buried: bool = False
    ) -> NDArray[np.float32]:
        """Return ranges (n,) [m].

        Args:
            physics: the world to look at.
            frame: where the sensor is.
            mask: overlooks the robot that carries it.
            random: noise and drop-out.
            buried: the sensor is inside a shape, where rays meet no surface: all beams are too close.
        """
        if buried:
            ranges = np.zeros(self.spec.beams)
        else:
            free = physics.cast(frame.origin, frame.origin + self._reach @ frame.axes, mask)
            ranges = np.where(free < 1.0, free * self.spec.range.high, np.inf)
        # Drawn whether used or not: two noise levels with the same seed then differ by scale alone.
        error, lot = random.standard_normal(self.spec.beams), random.random(self.spec.beams)
        ranges += self.noise * error
        ranges[ranges > self.spec.range.high] = np.inf
        ranges[ranges < self.spec.range.low] = -np.inf
        ranges[lot < self.dropout] = self._lost
        return ranges.astype(np.float32)

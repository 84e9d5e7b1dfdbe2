"""The observation of a learnt policy: nearness at fixed bearings of the lidar, speed and turn rate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ctrl_rl_core.robots import DEFAULT_ROBOT
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry, Sectors, find_robot
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError

STEP_TOLERANCE = 0.25
"""Relative difference up to which two scan intervals count as equal."""


@dataclass(frozen=True)
class LidarObservation:
    """x = nearness at bearings all around, then speed and turn rate, each of order 1.

    Nearness, `near` over distance, distinguishes 0.1 m from 0.2 m well and 3.0 m from 3.1 m hardly, as required for
    driving.

    Attributes:
        count: Number of adjacent sectors all around, counter-clockwise, the first one ahead.
        near: Distance with nearness one [m].
        closest: Lower bound of distances [m].
        far: Upper bound of distances, also used without an echo [m].
        speed: Speed that maps to 1 [m/s].
        turn: Turn rate that maps to 1 [rad/s].
    """

    count: int = 36
    near: float = 0.35
    closest: float = 0.12
    far: float = 3.5
    speed: float = find_robot(DEFAULT_ROBOT).speed
    turn: float = 1.5

    def __post_init__(self) -> None:
        if self.count < 4 or not 0.0 < self.closest < self.far or min(self.near, self.speed, self.turn) <= 0.0:
            raise KoopmanError(
                f"{self} is not valid: must have at least 4 sectors, positive lengths and units, and closest < far"
            )

    @cached_property
    def sectors(self) -> Sectors:
        """Sectors to which a scan is resampled."""
        spacing = 2.0 * np.pi / self.count
        return Sectors(tuple(float(spacing * index) for index in range(self.count)), 0.5 * spacing, self.far)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each component of x."""
        degrees = (360.0 * index / self.count for index in range(self.count))
        return (*(f"nearness at {angle:g} deg" for angle in degrees), "speed", "turn rate")

    @property
    def mirror(self) -> tuple[NDArray[np.intp], Array]:
        """Order and sign of x's components with left and right swapped (count + 2,): x[order] * sign."""
        sectors = -np.arange(self.count) % self.count
        order = np.concatenate((sectors, (self.count, self.count + 1))).astype(np.intp)
        return order, np.concatenate((np.ones(self.count + 1), (-1.0,)))

    def observe(self, ranges: NDArray[np.float32], scan: ScanGeometry, v: float, omega: float) -> Array:
        """Return x (count + 2,) for one scan and the odometry's speed [m/s] and turn rate [rad/s].

        Raises:
            ScanError: The scan has no measurement.
            KoopmanError: Speed or turn rate are not finite.
        """
        check_speeds(v, omega)
        x = np.empty(self.count + 2)
        np.divide(self.near, np.maximum(self.sectors.distances(ranges, scan), self.closest), out=x[:-2])
        x[-2], x[-1] = v / self.speed, omega / self.turn
        return x


def check_speeds(v: float, omega: float) -> None:
    """Raise if odometry speeds are not finite.

    Raises:
        KoopmanError: Speed or turn rate are not finite.
    """
    if not (math.isfinite(v) and math.isfinite(omega)):
        raise KoopmanError(f"odometry with speed {v} and turn rate {omega}")

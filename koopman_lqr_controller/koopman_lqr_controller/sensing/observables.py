"""The user-defined functions Psi of classical Koopman control (thesis Eq. 2.30), for a robot between walls.

Nearness, one over distance, is nearly linear in the robot's position and heading: between two walls at width w, offset
e and heading phi, a beam at bearing b sees sin(b + phi) / (w/2 - e). The difference between left and right is zero in
the middle of a straight corridor, grows without bound towards a wall, and at bearings ahead shows the next bend early.
These differences and the turn rate change sign when left and right are swapped; the speed does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry, Sectors
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.sensing.lidar_observation import check_speeds


@dataclass(frozen=True)
class CorridorObservables:
    """Left minus right nearness at mirrored bearings, then turn rate and speed.

    Attributes:
        bearings_deg: Bearings of the left beams, counter-clockwise from ahead, inside (0, 180) [deg].
        half_width_deg: Half the width of a sector [deg].
        near: Distance with nearness one [m].
        closest: Lower bound of distances [m].
        far: Upper bound of distances [m].
    """

    bearings_deg: tuple[float, ...] = tuple(float(angle) for angle in range(10, 180, 10))
    half_width_deg: float = 5.0
    near: float = 0.35
    closest: float = 0.12
    far: float = 3.5

    @cached_property
    def sectors(self) -> Sectors:
        """Sectors to which a scan is resampled, counter-clockwise from the rear right to the rear left."""
        left = np.deg2rad(self.bearings_deg)
        return Sectors((*(-left[::-1]).tolist(), *left.tolist()), float(np.deg2rad(self.half_width_deg)), self.far)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each component of z."""
        return (*(f"nearness left - right at {angle:g} deg" for angle in self.bearings_deg), "turn rate", "speed")

    @property
    def mirror(self) -> Array:
        """Sign of each component with left and right swapped (n,)."""
        return np.array([-1.0] * (len(self.bearings_deg) + 1) + [1.0])

    def observe(self, ranges: NDArray[np.float32], scan: ScanGeometry, v: float, omega: float) -> Array:
        """Return Psi(x) (n,) for one scan and the odometry's speed [m/s] and turn rate [rad/s].

        All components are dimensionless except the last two, the turn rate and the speed.

        Raises:
            ScanError: The scan has no usable beam.
            KoopmanError: Speed or turn rate are not finite.
        """
        check_speeds(v, omega)
        half = len(self.bearings_deg)
        nearness = self.near / np.maximum(self.sectors.distances(ranges, scan), self.closest)
        return np.concatenate((nearness[half:] - nearness[half - 1 :: -1], (omega, v)))

    def state_cost(self, side: float, ahead: float, speed: float) -> Array:
        """Return the diagonal of Q (n,): weights on lateral offset, a wall ahead, and speed error.

        Args:
            side: Weight on the nearness differences at 60 to 120 deg, together.
            ahead: Weight on the nearness differences below 60 deg, together.
            speed: Weight on the squared speed error [s^2/m^2].
        """
        angle = np.array(self.bearings_deg)
        beside, before = (angle >= 60) & (angle <= 120), angle < 60
        weights: Sequence[Array] = (
            side * beside / max(1, beside.sum()) + ahead * before / max(1, before.sum()),
            np.array([0.0, speed]),
        )
        return np.concatenate(weights)

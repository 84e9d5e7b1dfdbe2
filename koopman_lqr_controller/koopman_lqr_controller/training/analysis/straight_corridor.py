"""A robot between two straight walls, in closed form, to linearise a corridor policy near the middle line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.sensing.lidar import ScanGeometry

_BEAMS = 360


@dataclass(frozen=True)
class StraightCorridor:
    """A unicycle that does at once what it is told. State: offset to the left [m], heading [rad], speed, turn rate.

    Where it is along the corridor changes nothing and is left out.

    Attributes:
        width: Between the walls [m].
        dt: Time for which a command is held [s].
        range_max: Longest range of the lidar, which sits in the robot's middle [m].
    """

    width: float
    dt: float
    range_max: float = 3.5

    def step(self, state: Array, command: Array) -> Array:
        """Return the next state (4,) under a command (2,): speed [m/s], turn rate [rad/s]."""
        offset, heading, (v, omega) = float(state[0]), float(state[1]), command
        turned = 0.5 * omega * self.dt
        # The chord of an arc: sinc is the one of NumPy, sin(pi x) / (pi x).
        return np.array(
            [
                offset + v * self.dt * np.sinc(turned / np.pi) * np.sin(heading + turned),
                heading + omega * self.dt,
                v,
                omega,
            ]
        )

    @property
    def geometry(self) -> ScanGeometry:
        """The lidar's."""
        return ScanGeometry(_BEAMS, 0.0, 2.0 * np.pi / _BEAMS, 0.0, self.range_max)

    def scan(self, state: Array) -> NDArray[np.float32]:
        """Return the exact ranges (beams,) [m]; infinite where the wall is out of reach."""
        across = np.sin(np.arange(_BEAMS) * (2.0 * np.pi / _BEAMS) + state[1])
        gap = np.where(across > 0.0, 0.5 * self.width - state[0], 0.5 * self.width + state[0])
        ranges = gap / np.maximum(np.abs(across), 1e-9)
        return np.where(ranges > self.range_max, np.inf, ranges).astype(np.float32)

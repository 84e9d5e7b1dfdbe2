"""Size and limits of a differential drive, which value, look-ahead and simulation share."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ctrl_rl_navigation.errors import NavigationError


@dataclass(frozen=True)
class DriveLimits:
    """A round robot that drives forwards and turns on the spot; the defaults are a TurtleBot3 burger's.

    Attributes:
        speed: Largest speed [m/s].
        turn_rate: Largest turn rate [rad/s].
        acceleration: Largest change of the speed [m/s^2].
        turn_acceleration: Largest change of the turn rate [rad/s^2].
        radius: Radius of the disc around the robot's middle that holds all of it [m].
        margin: Additional distance to obstacles [m].

    Raises:
        NavigationError: A number is not finite, or is zero or less.
    """

    speed: float = 0.22
    turn_rate: float = 2.0
    acceleration: float = 1.0
    turn_acceleration: float = 6.0
    radius: float = 0.125
    margin: float = 0.025

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (0.0 < value < math.inf):
                raise NavigationError(f"{field.name} {value}: must be a positive number")

    @property
    def room(self) -> float:
        """Least distance of the robot's middle to an obstacle [m]."""
        return self.radius + self.margin

"""Size and limits of a differential drive, which value, look-ahead and simulation share."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ctrl_rl_navigation.errors import NavigationError


@dataclass(frozen=True)
class DriveLimits:
    """A robot that drives forwards and turns on the spot; the defaults are a TurtleBot3 burger's.

    Attributes:
        speed: Largest speed [m/s].
        turn_rate: Largest turn rate [rad/s].
        acceleration: Largest change of the speed [m/s^2].
        turn_acceleration: Largest change of the turn rate [rad/s^2].
        radius: Radius of the disc around the robot's middle that holds all of it [m].
        margin: Additional distance to obstacles [m].
        length: Length of a rectangular robot [m]; 0 for a round one.
        width: Width of a rectangular robot [m]; 0 for a round one.

    Raises:
        NavigationError: A number is not finite, is zero or less, or a length is without a width.
    """

    speed: float = 0.22
    turn_rate: float = 2.0
    acceleration: float = 1.0
    turn_acceleration: float = 6.0
    radius: float = 0.125
    margin: float = 0.025
    length: float = 0.0
    width: float = 0.0

    def __post_init__(self) -> None:
        shape = () if self.length == self.width == 0.0 else ("length", "width")
        for name in (*(field.name for field in fields(self)[:6]), *shape):
            value = getattr(self, name)
            if not (0.0 < value < math.inf):
                raise NavigationError(f"{name} {value}: must be a positive number")

    @property
    def room(self) -> float:
        """Least distance of the robot's middle to an obstacle beside it [m]."""
        return (0.5 * self.width if self.width else self.radius) + self.margin

    @property
    def gap(self) -> float:
        """Least distance of an obstacle to the core of the robot [m]: to its rectangle, or to a round one's middle."""
        return self.margin if self.width else self.radius + self.margin

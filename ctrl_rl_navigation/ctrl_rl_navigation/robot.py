"""Size and limits of a differential drive, which value, look-ahead and simulation share."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ctrl_rl_core import Robot
from ctrl_rl_navigation.errors import NavigationError

MARGIN = 0.025
"""Distance to obstacles in addition to the robot's size [m]."""


@dataclass(frozen=True)
class DriveLimits:
    """A robot that drives forwards and turns on the spot, see `limits_of`.

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

    speed: float
    turn_rate: float
    acceleration: float
    turn_acceleration: float
    radius: float
    margin: float = MARGIN
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


def limits_of(robot: Robot, margin: float = MARGIN) -> DriveLimits:
    """Return the size of a robot, and what its drivers ask it for, with a margin to obstacles [m].

    Raises:
        NavigationError: It does not drive on wheels.
    """
    if robot.kind != "differential_drive":
        raise NavigationError(f"robot '{robot.name}' does not drive on wheels")
    plan = robot.plan
    return DriveLimits(
        plan.speed,
        plan.turn_rate,
        plan.acceleration,
        plan.turn_acceleration,
        robot.radius,
        margin,
        robot.length,
        robot.width,
    )

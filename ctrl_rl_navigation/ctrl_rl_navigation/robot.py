"""Size and limits of a differential drive, shared by value, look-ahead and simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ctrl_rl_core import Robot
from ctrl_rl_navigation.errors import NavigationError

MARGIN = 0.025
"""Distance to obstacles in addition to the robot's size [m]."""
_ALL_AROUND = 6.1
"""Least field of view of a lidar that sees all around [rad]."""


@dataclass(frozen=True)
class DriveLimits:
    """A robot that drives forwards and turns in place, see `limits_of`.

    Attributes:
        speed: Maximum speed [m/s].
        turn_rate: Maximum turn rate [rad/s].
        acceleration: Maximum acceleration [m/s^2].
        turn_acceleration: Maximum angular acceleration [rad/s^2].
        radius: Radius of the disc around the robot's centre that encloses the robot [m].
        margin: Additional distance to obstacles [m].
        length: Length of a rectangular robot [m]; 0 for a round one.
        width: Width of a rectangular robot [m]; 0 for a round one.
        reverse_speed: Maximum speed backwards, to make room for people [m/s]; 0 for never.

    Raises:
        NavigationError: A number is not finite or not positive, or only one of length and width is given.
    """

    speed: float
    turn_rate: float
    acceleration: float
    turn_acceleration: float
    radius: float
    margin: float = MARGIN
    length: float = 0.0
    width: float = 0.0
    reverse_speed: float = 0.0

    def __post_init__(self) -> None:
        shape = () if self.length == self.width == 0.0 else ("length", "width")
        for name in (*(field.name for field in fields(self)[:6]), *shape):
            value = getattr(self, name)
            if not (0.0 < value < math.inf):
                raise NavigationError(f"{name} {value}: must be a positive number")

    @property
    def room(self) -> float:
        """Minimum distance from the robot's centre to an obstacle beside it [m]."""
        return (0.5 * self.width if self.width else self.radius) + self.margin

    @property
    def gap(self) -> float:
        """Minimum distance from an obstacle to the robot's core [m]: its rectangle, or a round robot's centre."""
        return self.margin if self.width else self.radius + self.margin


def limits_of(robot: Robot, margin: float = MARGIN) -> DriveLimits:
    """Return the size and planning limits of a robot, with a margin to obstacles [m].

    It makes room backwards only if its lidar sees what is there.

    Raises:
        NavigationError: The robot has no wheels, or is a car.
    """
    if robot.kind != "differential_drive":
        kind = "is a car, see ctrl_rl_navigation.cars" if robot.steering else "does not drive on wheels"
        raise NavigationError(f"robot '{robot.name}' {kind}")
    plan, lidar = robot.plan, robot.lidar.spec
    sees_back = lidar is not None and lidar.field.length > _ALL_AROUND
    return DriveLimits(
        plan.speed,
        plan.turn_rate,
        plan.acceleration,
        plan.turn_acceleration,
        robot.radius,
        margin,
        robot.length,
        robot.width,
        min(robot.reverse_speed, plan.speed) if sees_back else 0.0,
    )

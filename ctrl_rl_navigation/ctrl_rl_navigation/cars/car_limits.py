"""Size and limits of a car, shared by value, look-ahead and simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ctrl_rl_core import Robot
from ctrl_rl_navigation.errors import NavigationError

MARGIN = 0.05
"""Distance to obstacles in addition to the car's rectangle [m]."""


@dataclass(frozen=True)
class CarLimits:
    """A car whose rear axle does not slip sideways, see `car_limits_of`.

    Attributes:
        speed: Maximum forward speed [m/s].
        reverse_speed: Maximum reverse speed [m/s].
        acceleration: Maximum rate of change of the speed away from zero [m/s^2].
        braking: Deceleration towards zero speed [m/s^2].
        turning_radius: Radius of the tightest turn, of the middle of the rear axle [m].
        wheelbase: Distance between the axles [m].
        steering_rate: Maximum rate of the steering angle [rad/s].
        length: Length of the rectangle [m].
        width: Width of the rectangle [m].
        centre: Position of the rectangle's middle ahead of the rear axle [m].
        margin: Additional distance to obstacles [m].
        lag: Time constant with which the speed follows its command [s].
        steering_lag: Time constant with which the steering angle follows its command [s].
        hardest_braking: Deceleration where planned braking no longer averts a contact [m/s^2]; 0 for `braking`.

    Raises:
        NavigationError: A number is not finite or not positive.
    """

    speed: float
    reverse_speed: float
    acceleration: float
    braking: float
    turning_radius: float
    wheelbase: float
    steering_rate: float
    length: float
    width: float
    centre: float
    margin: float = MARGIN
    lag: float = 0.0
    steering_lag: float = 0.0
    hardest_braking: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            least = field.name in ("centre", "margin", "lag", "steering_lag", "hardest_braking")
            if not (0.0 < value < math.inf or (least and value == 0.0)):
                raise NavigationError(f"{field.name} {value}: must be a positive number")

    @property
    def room(self) -> float:
        """Minimum distance from the rear axle's middle to an obstacle beside it [m]."""
        return 0.5 * self.width + self.margin

    @property
    def radius(self) -> float:
        """Radius of the disc around the rear axle's middle that encloses the car [m]."""
        return math.hypot(self.centre + 0.5 * self.length, 0.5 * self.width)

    @property
    def steering_angle(self) -> float:
        """Maximum steering angle [rad]."""
        return math.atan2(self.wheelbase, self.turning_radius)

    @property
    def change_time(self) -> float:
        """Mean time lost by a change between forward and reverse [s]: a stop, and steering from middle to end."""
        return self.stop_time + self.steering_angle / self.steering_rate

    @property
    def stop_time(self) -> float:
        """Mean time lost by braking to a stop, and by speeding up again [s]."""
        return 0.25 * (self.speed + self.reverse_speed) * (1.0 / self.braking + 1.0 / self.acceleration)


def car_limits_of(robot: Robot, margin: float = MARGIN) -> CarLimits:
    """Return the size and planning limits of a car, with a margin to obstacles [m].

    Raises:
        NavigationError: The robot has no steering.
    """
    steering, plan = robot.steering, robot.plan
    if steering is None:
        raise NavigationError(f"robot '{robot.name}' has no steering")
    return CarLimits(
        plan.speed,
        min(robot.reverse_speed, plan.speed),
        plan.acceleration,
        plan.braking,
        steering.turning_radius,
        steering.wheelbase,
        steering.rate,
        robot.length,
        robot.width,
        steering.centre,
        margin,
        robot.lag,
        steering.lag,
        max(robot.braking, plan.braking),
    )

"""The filter's model of a car, whose front wheels are steered, and its motion in time steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple

from numba import njit

from ctrl_rl_core import Robot, RobotError, find_robot
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.models.motion import next_speeds
from ctrl_rl_safety.models.robot_model import RobotModel


@dataclass(frozen=True)
class CarModel(RobotModel):
    """A car (x, y, theta, v, delta) whose rear axle does not slip, with the speeds of a `RobotModel`.

    The rectangle lies ahead of the rear axle's middle (x, y), and `radius` is that of a disc around the rectangle's
    middle. A command (v_c, omega_c) asks for the curvature omega_c / v_c; at v_c = 0 the front wheels stay as they are:

        theta' = v tan(delta) / wheelbase
        delta' = (atan(wheelbase omega_c / v_c) - delta) / steering_lag, within steering_rate

    Attributes:
        wheelbase: Distance from the rear axle to the front axle [m].
        turning_radius: Radius of the tightest turn, of the middle of the rear axle [m].
        steering_rate: Maximum rate of the steering angle [rad/s].
        steering_lag: Time constant with which the steering angle follows its command [s].
        centre: Distance from the rear axle forward to the middle of the rectangle [m].

    Raises:
        SafetyError: A number is not finite or out of range.
    """

    steered: ClassVar[bool] = True
    wheelbase: float = 1.0
    turning_radius: float = 1.0
    steering_rate: float = 1.0
    steering_lag: float = 0.0
    centre: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.length <= 0.0:
            raise SafetyError("a car needs length and width: its corners swing out in turns")

    @property
    def steering_angle(self) -> float:
        """Maximum steering angle [rad]."""
        return math.atan2(self.wheelbase, self.turning_radius)

    @classmethod
    def of(cls, robot: Robot) -> CarModel:
        """Create the filter's model of a car.

        Raises:
            SafetyError: The robot has no steering.
        """
        steering = robot.steering
        if steering is None:
            raise SafetyError(f"robot '{robot.name}' has no steering")
        own = {each.name: getattr(robot, each.name) for each in fields(RobotModel) if each.name != "missing_rate"}
        own["radius"] = math.hypot(0.5 * robot.length, 0.5 * robot.width)
        return cls(
            **own,
            missing_rate=robot.lidar.missing_rate,
            wheelbase=steering.wheelbase,
            turning_radius=steering.turning_radius,
            steering_rate=steering.rate,
            steering_lag=steering.lag,
            centre=steering.centre,
        )


class Steered(NamedTuple):
    """The steering of a car within one time step.

    Attributes:
        wheelbase: Distance between the axles [m].
        angle: Maximum steering angle [rad].
        share: Fraction of the difference to the command that is covered in a step.
        most: Maximum change of the angle in a step [rad].
        centre: Distance from the rear axle forward to the middle of the rectangle [m].
    """

    wheelbase: float
    angle: float
    share: float
    most: float
    centre: float


def steered_of(model: CarModel, step: float) -> Steered:
    """Return the steering of a car for a time step [s]."""
    share = -math.expm1(-step / model.steering_lag) if model.steering_lag > 0.0 else 1.0
    return Steered(model.wheelbase, model.steering_angle, share, model.steering_rate * step, model.centre)


@njit(inline="always")
def next_of_car(state: Any, v_c: float, omega_c: float, motion: Any, car: Any) -> Any:
    """Return x, y, heading, speed and steering angle after a step, of the rear axle's middle."""
    x, y, theta, v, delta = state
    if v_c != 0.0:
        wanted = min(max(math.atan(car.wheelbase * omega_c / v_c), -car.angle), car.angle)
        delta += min(max(car.share * (wanted - delta), -car.most), car.most)
    faster, _ = next_speeds(v, 0.0, v_c, 0.0, motion)
    way = 0.5 * (v + faster) * motion.step
    turn = way * math.tan(delta) / car.wheelbase
    middle = theta + 0.5 * turn
    return x + way * math.cos(middle), y + way * math.sin(middle), theta + turn, faster, delta


def find_vehicle(name: str) -> RobotModel:
    """Return the model of a robot or a car by name or by the path of its YAML file.

    Raises:
        SafetyError: Neither exists, or it does not drive on wheels.
    """
    try:
        robot = find_robot(name)
    except RobotError as error:
        raise SafetyError(str(error)) from None
    return CarModel.of(robot) if robot.steering is not None else RobotModel.of(robot)

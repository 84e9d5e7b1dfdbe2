"""The filter's model of a wheeled robot: size, limits, delay and errors, from the robot's file."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import ClassVar

import yaml
from ctrl_rl_core.robots import robot_names

from ctrl_rl_core import Robot, RobotError, atomic_write, find_robot
from ctrl_rl_safety.errors import SafetyError

UNITS: Mapping[str, str] = {
    "radius": "m",
    "speed": "m/s",
    "reverse_speed": "m/s",
    "turn_rate": "rad/s",
    "acceleration": "m/s^2",
    "braking": "m/s^2",
    "turn_acceleration": "rad/s^2",
    "lag": "s",
    "delay": "s",
    "disturbance": "m/s",
    "range_error": "m",
    "scan_age": "s",
    "length": "m",
    "width": "m",
    "track": "m",
    "missing_rate": "",
}
LARGEST: Mapping[str, float] = {
    "radius": 5.0,
    "speed": 20.0,
    "reverse_speed": 20.0,
    "turn_rate": 50.0,
    "acceleration": 100.0,
    "braking": 100.0,
    "turn_acceleration": 500.0,
    "lag": 2.0,
    "delay": 2.0,
    "disturbance": 2.0,
    "range_error": 1.0,
    "scan_age": 2.0,
    "length": 10.0,
    "width": 10.0,
    "track": 10.0,
    "missing_rate": 0.5,
}
"""Maximum value of each constant."""
_OPTIONAL = {"lag", "delay", "disturbance", "range_error", "scan_age", "length", "width", "track", "missing_rate"}
_NO_KEY = {"name", "missing_rate"}
"""Constants that a robot's file has elsewhere than among its lengths and limits."""
_MAY_BE_ZERO = {"reverse_speed", *_OPTIONAL}


@dataclass(frozen=True)
class RobotModel:
    """A robot (x, y, theta, v, omega) that follows its command (v_c, omega_c) with delay, lag and limited rates.

    Its shape is a disc, or a rectangle centred at the point of rotation.

        x' = v cos theta + d_x,  y' = v sin theta + d_y,  theta' = omega,  |(d_x, d_y)| <= disturbance
        v' = (v_c(t - delay) - v) / lag, within acceleration away from zero and braking towards it
        omega' = (omega_c(t - delay) - omega) / lag, within turn_acceleration

    With a `track`, acceleration and turn acceleration are those of two wheels at full force, together and against each
    other, so a wheel at its limit reduces both.

    Attributes:
        name: Name of the robot.
        radius: Radius of the disc around the robot's centre that encloses the robot [m].
        speed: Maximum forward speed [m/s].
        reverse_speed: Maximum reverse speed [m/s].
        turn_rate: Maximum turn rate [rad/s].
        acceleration: Maximum rate of change of the speed away from zero [m/s^2].
        braking: Guaranteed deceleration towards zero speed [m/s^2].
        turn_acceleration: Guaranteed angular acceleration [rad/s^2].
        lag: Time constant with which speeds follow their commands [s].
        delay: Time from a command to its effect [s].
        disturbance: Bound of the position's deviation from the model per second of motion [m/s].
        range_error: Bound of the position error of an echo [m].
        scan_age: Bound of the time by which an echo is older than its scan's stamp [s].
        length: Length of a rectangular robot [m]; 0 for a round one.
        width: Width of a rectangular robot [m]; 0 for a round one.
        track: Distance between two driven wheels [m]; 0 if speed and turn rate change independently.
        missing_rate: Probability that a scan misses what its beams hit, 0 to 0.5.

    Raises:
        SafetyError: A number is not finite or is out of range for a robot, or the rectangle has only one side or does
            not lie in the disc.
    """

    steered: ClassVar[bool] = False
    """Whether front wheels are steered, so that the robot cannot turn on the spot."""
    name: str
    radius: float
    speed: float
    reverse_speed: float
    turn_rate: float
    acceleration: float
    braking: float
    turn_acceleration: float
    lag: float = 0.0
    delay: float = 0.0
    disturbance: float = 0.0
    range_error: float = 0.0
    scan_age: float = 0.0
    length: float = 0.0
    width: float = 0.0
    track: float = 0.0
    missing_rate: float = 0.1

    def __post_init__(self) -> None:
        for name, largest in LARGEST.items():
            value, least = getattr(self, name), "0" if name in _MAY_BE_ZERO else "more than 0"
            if not (math.isfinite(value) and 0.0 <= value <= largest and (value > 0.0 or least == "0")):
                raise SafetyError(f"{name} {value} {UNITS[name]}: must be {least} to {largest:g}")
        if (self.length > 0.0) != (self.width > 0.0):
            raise SafetyError("a rectangle needs both length and width: leave both out for a round robot")
        if math.hypot(*self.core) > self.radius + 1e-3:
            raise SafetyError(f"a rectangle of {self.length} x {self.width} m is not in a disc of {self.radius} m")

    @property
    def limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Minimum and maximum command: speed [m/s] and turn rate [rad/s] each."""
        return (-self.reverse_speed, -self.turn_rate), (self.speed, self.turn_rate)

    @property
    def core(self) -> tuple[float, float]:
        """Half the length and half the width of the rectangle [m]; zeros for a disc."""
        return 0.5 * self.length, 0.5 * self.width

    @property
    def room(self) -> float:
        """Required distance from the core to an echo [m]: from the rectangle, or from the centre of a disc."""
        return self.range_error + (0.0 if self.length else self.radius)

    @property
    def half_width(self) -> float:
        """Half the width of the narrowest passage through which the robot fits [m]."""
        return min(self.core) if self.length else self.radius

    def stopping_distance(self, v: float) -> float:
        """Return the braking distance from a speed v [m/s], without the delay [m].

        With a lag, the speed falls by `braking` down to braking * lag, and exponentially from there.
        """
        bend = self.braking * self.lag
        fast = max(abs(v) - bend, 0.0)
        return fast * (fast + 2.0 * min(abs(v), bend)) / (2.0 * self.braking) + min(abs(v), bend) * self.lag

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the constants as a YAML file, atomically.

        Raises:
            OSError: The file cannot be written; the error names it.
        """
        content = {name: f"{value:.6g} {UNITS[name]}" for name, value in asdict(self).items() if name not in _NO_KEY}
        lidar = {"missing_rate": self.missing_rate}
        atomic_write(Path(path), yaml.safe_dump({"name": self.name, **content, "lidar": lidar}, sort_keys=False))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> RobotModel:
        """Read a YAML file.

        Raises:
            SafetyError: The file is missing, invalid, or lacks a constant; the message names it.
        """
        try:
            return cls.of(Robot.load(path))
        except RobotError as error:
            raise SafetyError(str(error)) from None

    @classmethod
    def of(cls, robot: Robot) -> RobotModel:
        """Create the filter's model of a robot.

        Raises:
            SafetyError: The robot has no wheels.
        """
        if robot.kind != "differential_drive":
            kind = (
                "is a car, and this needs a robot that turns on the spot"
                if robot.steering
                else "does not drive on wheels"
            )
            raise SafetyError(f"robot '{robot.name}' {kind}")
        own = {field.name: getattr(robot, field.name) for field in fields(cls) if field.name != "missing_rate"}
        return cls(**own, missing_rate=robot.lidar.missing_rate)


class _Robots(Mapping[str, RobotModel]):
    """The suite's wheeled robots, loaded on access."""

    def __getitem__(self, name: str) -> RobotModel:
        if name not in robot_names():
            raise KeyError(name)
        return RobotModel.of(find_robot(name))

    def __iter__(self) -> Iterator[str]:
        return (name for name in robot_names() if find_robot(name).kind == "differential_drive")

    def __len__(self) -> int:
        return sum(1 for _ in self)


ROBOTS: Mapping[str, RobotModel] = _Robots()
"""Constants of common robots; measure your own robot with `identify` before relying on them."""


def find_model(name: str) -> RobotModel:
    """Return the model of a robot by name or by the path of its YAML file.

    Raises:
        SafetyError: Neither exists.
    """
    try:
        return RobotModel.of(find_robot(name))
    except RobotError as error:
        raise SafetyError(str(error)) from None

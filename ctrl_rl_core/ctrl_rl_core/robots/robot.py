"""A robot defined by one file: `Robot.load("my_robot.yaml")`, or `find_robot("turtlebot3_burger")`.

    name: my_robot
    radius: 0.2 m
    speed: 0.5 m/s
    ...

Wherever a robot's name is accepted (task file, node parameter, command option), so is the path of such a file. A
package offers robots with entry points of the group `ctrl_rl.robots` that name a `Robot`:

    entry_points={"ctrl_rl.robots": ["my_robot = my_package:ROBOT"]}

`ros2 run ctrl_rl_safety identify` measures the values for a custom robot from a bag.
"""

from __future__ import annotations

import hashlib
import math
import os
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PrivateAttr, ValidationError, model_validator

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.geometry.units import parse_scalar
from ctrl_rl_core.io.checked_yaml import read_yaml
from ctrl_rl_core.io.file_checks import FileError, first_error, raise_as, short_path
from ctrl_rl_core.io.schema import Schema
from ctrl_rl_core.plugins import find_plugins, load_plugin
from ctrl_rl_core.robots.lidar import MountedLidar

GROUP = "ctrl_rl.robots"
FOLDER = Path(__file__).parent
DEFAULT_ROBOT = "turtlebot3_burger"
"""Default robot of nodes and commands."""
COMMANDS = {"differential_drive": ("v", "omega"), "car": ("v", "omega"), "planar_quadrotor": ("T_1", "T_2")}
"""Names of a robot's two commands by kind of base, in message order."""
_NEEDED = ("speed", "turn_rate", "acceleration", "braking", "turn_acceleration")
_DERIVED = ("turn_rate", "turn_acceleration")
"""Limits of a car that follow from its speed and steering."""
_ROUNDING = 1e-3


def _in(unit: str) -> BeforeValidator:
    """Return a validator for a number with this unit."""
    return BeforeValidator(lambda value: parse_scalar(value, unit))


Radius = Annotated[float, Field(gt=0.0, le=5.0), _in("m")]
Extent = Annotated[float, Field(ge=0.0, le=10.0), _in("m")]
Limit = Annotated[float, Field(ge=0.0, le=20.0), _in("m/s")]
TurnLimit = Annotated[float, Field(ge=0.0, le=50.0), _in("rad/s")]
Acceleration = Annotated[float, Field(ge=0.0, le=100.0), _in("m/s^2")]
TurnAcceleration = Annotated[float, Field(ge=0.0, le=500.0), _in("rad/s^2")]
Lag = Annotated[float, Field(ge=0.0, le=2.0), _in("s")]
Drift = Annotated[float, Field(ge=0.0, le=2.0), _in("m/s")]
RangeError = Annotated[float, Field(ge=0.0, le=1.0), _in("m")]
Torque = Annotated[float, Field(gt=0.0, le=1e4), _in("N m")]
Mass = Annotated[float, Field(ge=0.0, le=1e4), _in("kg")]


class RobotError(CtrlRlError):
    """The robot does not exist or its file is invalid; the message names it."""


class Wheels(Schema):
    """Two wheels driven by velocity-controlled motors.

    Attributes:
        radius: Radius of the wheels [m].
        separation: Distance between them [m].
        torque: Maximum torque of one wheel [N m].
        lag: Time constant of a wheel's speed [s].
        limited: Whether the base enforces the robot's limits; otherwise the simulator applies those of the task's
            commands.
    """

    radius: Radius
    separation: Radius
    torque: Torque
    lag: Annotated[float, Field(gt=0.0, le=5.0), _in("s")]
    limited: bool = True


class Steering(Schema):
    """Steered front wheels; the robot's centre is the middle of the rear axle, which does not slip sideways.

    Attributes:
        wheelbase: Distance from the rear axle to the front axle [m].
        turning_radius: Radius of the tightest turn, of the middle of the rear axle [m].
        rate: Maximum rate of the steering angle [rad/s].
        lag: Time constant with which the steering angle follows its command [s].
        centre: Distance from the rear axle forward to the middle of the rectangle `length` x `width` [m].
    """

    wheelbase: Radius
    turning_radius: Annotated[float, Field(gt=0.0, le=50.0), _in("m")]
    rate: Annotated[float, Field(gt=0.0, le=50.0), _in("rad/s")]
    lag: Lag = 0.0
    centre: Extent

    @property
    def angle(self) -> float:
        """Maximum steering angle, of a wheel in the middle of the front axle [rad]."""
        return math.atan2(self.wheelbase, self.turning_radius)


class Planning(Schema):
    """Limits for planning, where lower than the robot's own; 0 to use the robot's own.

    Attributes:
        speed: Maximum speed [m/s].
        turn_rate: Maximum turn rate [rad/s].
        acceleration: Maximum acceleration [m/s^2].
        braking: Deceleration in front of obstacles [m/s^2].
        turn_acceleration: Maximum angular acceleration [rad/s^2].
    """

    speed: Limit = 0.0
    turn_rate: TurnLimit = 0.0
    acceleration: Acceleration = 0.0
    braking: Acceleration = 0.0
    turn_acceleration: TurnAcceleration = 0.0


class Robot(Schema):
    """A robot; the only place for radii, limits and lidar positions.

    Attributes:
        name: Name of the robot.
        source: Source of the values.
        kind: Kind of base, which determines the commands.
        radius: Radius of the disc around the robot's centre that encloses the robot [m].
        gap_radius: Radius of the disc that enters narrow gaps straight ahead [m]; 0 for `radius`.
        length: Length of a rectangular robot [m], which rotates about its centre unless it is a car; 0 for a round one.
        width: Width of a rectangular robot [m]; 0 for a round one.
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
        track: Distance between two driven wheels whose force speed and turn rate share [m]; 0 if they do not.
        planning: Speeds and accelerations for planning, below the limits.
        mass: Mass of the whole robot [kg]; 0 if given by a URDF.
        wheels: Driven wheels; None for a robot that is never simulated.
        steering: Steered front wheels of a car, which needs `length` and `width` too; its turn rate and turn
            acceleration follow from speed and steering.
        base_height: Height of base_link above the floor [m].
        urdf: URDF file of the body, from the suite or beside this file; empty to build the body from these values.
        least_voltage: Minimum battery voltage [V]; 0 if unknown.
        lidar: Lidar with its mounting position.
    """

    name: str = Field(min_length=1, max_length=100)
    source: str = ""
    kind: Literal["differential_drive", "car", "planar_quadrotor"] = "differential_drive"
    radius: Radius
    gap_radius: Annotated[float, Field(ge=0.0, le=5.0), _in("m")] = 0.0
    length: Extent = 0.0
    width: Extent = 0.0
    speed: Limit = 0.0
    reverse_speed: Limit = 0.0
    turn_rate: TurnLimit = 0.0
    acceleration: Acceleration = 0.0
    braking: Acceleration = 0.0
    turn_acceleration: TurnAcceleration = 0.0
    lag: Lag = 0.0
    delay: Lag = 0.0
    disturbance: Drift = 0.0
    range_error: RangeError = 0.0
    scan_age: Lag = 0.0
    track: Extent = 0.0
    planning: Planning = Planning()
    mass: Mass = 0.0
    wheels: Wheels | None = None
    steering: Steering | None = None
    base_height: Extent = 0.0
    urdf: str = Field(default="", max_length=500)
    least_voltage: float = Field(default=0.0, ge=0.0, le=1000.0)
    lidar: MountedLidar = MountedLidar()
    _folder: Path | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _whole(self) -> Robot:
        self._take_steering()
        if self.on_wheels:
            missing = [name for name in _NEEDED if getattr(self, name) <= 0.0]
            if missing:
                raise ValueError(
                    f"lacks '{missing[0]}': a robot on wheels needs {', '.join(_NEEDED)}, each more than 0"
                )
        if (self.length > 0.0) != (self.width > 0.0):
            raise ValueError("a rectangle needs both length and width: leave both out for a round robot")
        ahead = 0.5 * self.length + (0.0 if self.steering is None else self.steering.centre)
        if math.hypot(ahead, 0.5 * self.width) > self.radius + _ROUNDING:
            raise ValueError(f"a rectangle of {self.length} x {self.width} m is not in a disc of {self.radius} m")
        for name, value, limit in (
            ("gap_radius", self.gap_radius, self.radius),
            ("planning.speed", self.planning.speed, self.speed),
            ("planning.turn_rate", self.planning.turn_rate, self.turn_rate),
        ):
            if value > limit:
                raise ValueError(f"{name}: {value:g} is more than the robot's own {limit:g}")
        if self.wheels is not None and not self.urdf:
            if self.mass <= 0.0:
                raise ValueError("wheels: without a URDF the simulator needs the robot's mass, e.g. mass: 3.0 kg")
            if self.wheels.separation >= 2.0 * self.radius:
                raise ValueError("wheels: are farther apart than the robot is wide")
        return self

    def _take_steering(self) -> None:
        """Check that a car, and only a car, has steering, and derive the limits that follow from it."""
        steering = self.steering
        if (steering is not None) != (self.kind == "car"):
            raise ValueError("steering: a robot of kind 'car' needs it, and no other may have it")
        if steering is None:
            return
        if self.length <= 0.0:
            raise ValueError("a car needs length and width: its corners swing out in turns")
        given = [name for name in _DERIVED if name in self.model_fields_set]
        if given:
            raise ValueError(f"{given[0]}: a car's follows from its speed and steering: leave it out")
        most = self.speed * steering.rate * (1.0 / steering.wheelbase + steering.wheelbase / steering.turning_radius**2)
        for name, value in zip(_DERIVED, (self.speed / steering.turning_radius, most), strict=True):
            object.__setattr__(self, name, value)  # the model is frozen from here on

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Robot:
        """Load a robot file.

        Raises:
            RobotError: The file is missing or invalid; the message names file and key.
        """
        file = Path(path).expanduser()
        with raise_as(RobotError, file):
            content = read_yaml(file)
            try:
                robot = cls.model_validate(content)
            except ValidationError as error:
                raise FileError(first_error(error)) from None
            robot._folder = file.resolve().parent
        return robot

    @property
    def on_wheels(self) -> bool:
        """Whether the robot drives on a floor by speed and turn rate."""
        return self.kind != "planar_quadrotor"

    @property
    def rectangle(self) -> tuple[float, float, float] | None:
        """Distance from a car's centre to its front and to its back, and half its width [m]; None for other robots."""
        if self.steering is None:
            return None
        half, ahead = 0.5 * self.length, self.steering.centre
        return half + ahead, half - ahead, 0.5 * self.width

    @property
    def commands(self) -> tuple[str, str]:
        """Names of the two commands, in message order."""
        return COMMANDS[self.kind]

    @property
    def limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Minimum and maximum command: speed [m/s] and turn rate [rad/s] each."""
        return (-self.reverse_speed, -self.turn_rate), (self.speed, self.turn_rate)

    @property
    def plan(self) -> Planning:
        """Limits for planning; values not given are the robot's own limits."""
        return Planning.model_construct(
            **{name: getattr(self.planning, name) or getattr(self, name) for name in Planning.model_fields}
        )

    @property
    def through_gaps(self) -> float:
        """Radius of the disc for narrow gaps, entered straight ahead [m]."""
        return self.gap_radius or self.radius

    @property
    def urdf_file(self) -> Path | None:
        """The URDF file beside the robot's own file; None for one of the suite's, or without a URDF."""
        file = None if self._folder is None or not self.urdf else self._folder / Path(self.urdf).expanduser()
        return file if file is not None and file.is_file() else None

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the robot's values, and of its own URDF file if it has one."""
        # The filter's belief about the lidar changes no body, nor does lacking steering: recorded digests stay valid.
        left_out: Any = {"source": True, "lidar": {"missing_rate"}} | ({} if self.steering else {"steering": True})
        content = self.model_dump_json(exclude=left_out).encode()
        return hashlib.sha256(content + (b"" if self.urdf_file is None else self.urdf_file.read_bytes())).hexdigest()


@cache
def _shipped(name: str) -> Robot:
    return Robot.load(FOLDER / f"{name}.yaml")


def robot_names() -> tuple[str, ...]:
    """Return the names of all robots, of the suite and of installed packages."""
    return (*sorted(file.stem for file in FOLDER.glob("*.yaml")), *find_plugins(GROUP))


def find_robot(name_or_path: str | os.PathLike[str], folder: Path | None = None) -> Robot:
    """Return a robot of the suite or of an installed package by name, or load a .yaml file.

    Args:
        name_or_path: Name, or path of a file.
        folder: Base folder of a relative path; the working directory by default.

    Raises:
        RobotError: The robot does not exist, or its file is invalid.
    """
    text = os.fspath(name_or_path)
    if text.endswith((".yaml", ".yml")):
        return Robot.load(robot_file(text, folder))
    if (FOLDER / f"{text}.yaml").is_file() and text.isidentifier():
        return _shipped(text)
    offered = find_plugins(GROUP)
    if text in offered:
        return load_plugin(offered[text], Robot, "robot", RobotError)
    raise RobotError(f"no robot '{short_path(text)}': there are {', '.join(robot_names())}, or give a .yaml file")


def robot_file(path: str, folder: Path | None = None) -> Path:
    """Return the path of a robot file, resolved against a folder if one is given."""
    file = Path(path).expanduser()
    return file if folder is None else folder / file

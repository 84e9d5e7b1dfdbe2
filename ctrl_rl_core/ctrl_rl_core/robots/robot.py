"""A robot by one file: `Robot.load("my_robot.yaml")`, or `find_robot("turtlebot3_burger")`.

    name: my_robot
    radius: 0.2 m
    speed: 0.5 m/s
    ...

Wherever a robot's name is taken (a task file, a node's parameter, an option of a command), the path of such a file is
taken too. A package offers robots by an entry point of the group `ctrl_rl.robots` that names a `Robot`:

    entry_points={"ctrl_rl.robots": ["my_robot = my_package:ROBOT"]}

`ros2 run ctrl_rl_safety identify` measures the numbers of a robot of one's own from a bag.
"""

from __future__ import annotations

import hashlib
import math
import os
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

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
"""The robot of nodes and commands that are told of none."""
COMMANDS = {"differential_drive": ("v", "omega"), "planar_quadrotor": ("T_1", "T_2")}
"""Names of a robot's two commands by its kind, in the order of messages."""
_NEEDED = ("speed", "turn_rate", "acceleration", "braking", "turn_acceleration")
_ROUNDING = 1e-3


def _in(unit: str) -> BeforeValidator:
    """Return the validator of a number with its unit."""
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
    """There is no such robot, or its file is wrong; the message names it."""


class Wheels(Schema):
    """Two wheels on velocity motors.

    Attributes:
        radius: Radius of the wheels [m].
        separation: Distance between them [m].
        torque: Largest torque of one wheel [N m].
        lag: Time constant of a wheel's speed [s].
        limited: Whether the base keeps to the robot's limits; else those of a task's commands count in the simulator.
    """

    radius: Radius
    separation: Radius
    torque: Torque
    lag: Annotated[float, Field(gt=0.0, le=5.0), _in("s")]
    limited: bool = True


class Planning(Schema):
    """What drivers ask a robot for, where that is less than its limits; 0 for those.

    Attributes:
        speed: Largest speed [m/s].
        turn_rate: Largest turn rate [rad/s].
        acceleration: Largest change of the speed [m/s^2].
        braking: Deceleration in front of obstacles [m/s^2].
        turn_acceleration: Largest change of the turn rate [rad/s^2].
    """

    speed: Limit = 0.0
    turn_rate: TurnLimit = 0.0
    acceleration: Acceleration = 0.0
    braking: Acceleration = 0.0
    turn_acceleration: TurnAcceleration = 0.0


class Robot(Schema):
    """A robot; nothing else knows a radius, a limit or where a lidar sits.

    Attributes:
        name: Name of the robot.
        source: Origin of the numbers.
        kind: Kind of its base, which says what its commands are.
        radius: Radius of the disc around the robot's middle that holds all of it [m].
        gap_radius: Radius of the disc with which it enters narrow gaps straight ahead [m]; 0 for `radius`.
        length: Length of a rectangular robot, whose middle is where it turns around [m]; 0 for a round one.
        width: Width of a rectangular robot [m]; 0 for a round one.
        speed: Largest speed forwards [m/s].
        reverse_speed: Largest speed backwards [m/s].
        turn_rate: Largest turn rate [rad/s].
        acceleration: Largest change of the speed away from zero [m/s^2].
        braking: Largest change of the speed towards zero that it surely has [m/s^2].
        turn_acceleration: Largest change of the turn rate that it surely has [rad/s^2].
        lag: Time constant with which speeds follow their commands [s].
        delay: Time from a command to its effect [s].
        disturbance: Bound of the position's deviation from the model, for each second of motion [m/s].
        range_error: Bound of the error of an echo's place [m].
        scan_age: Bound of the time by which an echo is older than the stamp of its scan says [s].
        track: Distance between two driven wheels whose force speed and turn rate share [m]; 0 where they do not.
        planning: Speeds and accelerations that drivers ask for, below the limits.
        mass: Mass of the whole robot [kg]; 0 where a URDF tells it.
        wheels: Driven wheels; None for a robot that is never simulated.
        base_height: Height of base_link above the floor [m].
        urdf: URDF file of its body, one of the suite's or beside this file; empty for a body of these numbers.
        least_voltage: Least voltage of its battery [V]; 0 where nobody knows.
        lidar: Lidar, with its place on the robot.
    """

    name: str = Field(min_length=1, max_length=100)
    source: str = ""
    kind: Literal["differential_drive", "planar_quadrotor"] = "differential_drive"
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
    base_height: Extent = 0.0
    urdf: str = Field(default="", max_length=500)
    least_voltage: float = Field(default=0.0, ge=0.0, le=1000.0)
    lidar: MountedLidar = MountedLidar()
    _folder: Path | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _whole(self) -> Robot:
        if self.kind == "differential_drive":
            missing = [name for name in _NEEDED if getattr(self, name) <= 0.0]
            if missing:
                raise ValueError(
                    f"lacks '{missing[0]}': a robot on wheels needs {', '.join(_NEEDED)}, each more than 0"
                )
        if (self.length > 0.0) != (self.width > 0.0):
            raise ValueError("a rectangle needs both length and width: leave both out for a round robot")
        if math.hypot(0.5 * self.length, 0.5 * self.width) > self.radius + _ROUNDING:
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

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Robot:
        """Read a robot's file.

        Raises:
            RobotError: It is missing or wrong; the message names file and key.
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
    def commands(self) -> tuple[str, str]:
        """Names of its two commands, in the order of messages."""
        return COMMANDS[self.kind]

    @property
    def limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Least and largest command: speed [m/s] and turn rate [rad/s] each."""
        return (-self.reverse_speed, -self.turn_rate), (self.speed, self.turn_rate)

    @property
    def plan(self) -> Planning:
        """What drivers ask it for, its limits where it says nothing else."""
        return Planning.model_construct(
            **{name: getattr(self.planning, name) or getattr(self, name) for name in Planning.model_fields}
        )

    @property
    def through_gaps(self) -> float:
        """Radius of the disc with which it goes through narrow gaps, entered straight ahead [m]."""
        return self.gap_radius or self.radius

    @property
    def urdf_file(self) -> Path | None:
        """The URDF file beside its own file; None for one of the suite's, or none at all."""
        file = None if self._folder is None or not self.urdf else self._folder / Path(self.urdf).expanduser()
        return file if file is not None and file.is_file() else None

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of its numbers, and of its URDF file where it has one of its own."""
        content = self.model_dump_json(exclude={"source"}).encode()
        return hashlib.sha256(content + (b"" if self.urdf_file is None else self.urdf_file.read_bytes())).hexdigest()


@cache
def _shipped(name: str) -> Robot:
    return Robot.load(FOLDER / f"{name}.yaml")


def robot_names() -> tuple[str, ...]:
    """Return the names of the suite's robots, and of those of installed packages."""
    return (*sorted(file.stem for file in FOLDER.glob("*.yaml")), *find_plugins(GROUP))


def find_robot(name_or_path: str | os.PathLike[str], folder: Path | None = None) -> Robot:
    """Return a robot of the suite or of an installed package by name, or that of a .yaml file.

    Args:
        name_or_path: Name, or path of a file.
        folder: Folder that a relative path is taken from; the working directory unless given.

    Raises:
        RobotError: There is none, or its file is wrong.
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
    """Return the path of a robot's file, which is relative to a folder where one is given."""
    file = Path(path).expanduser()
    return file if folder is None else folder / file

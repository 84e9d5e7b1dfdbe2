"""The parts of a navigation task file, each with its checks; every quantity carries its unit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, Field, Strict, model_validator

from ctrl_rl_core.geometry.shapes import Arc, ArcPath, Box, Disc, Shape, frame_walls
from ctrl_rl_core.geometry.units import (
    Angle,
    AngleInterval,
    Interval,
    Length,
    LengthInterval,
    Point,
    PositiveLength,
    PositiveRate,
    TimeStep,
    parse_interval,
    parse_scalar,
)
from ctrl_rl_core.io.file_checks import short_repr
from ctrl_rl_core.io.schema import Schema
from ctrl_rl_core.systems.models import SYSTEM_MODELS
from ctrl_rl_core.systems.system import System, SystemModelError, make_system
from ctrl_rl_core.tasks.regions import Region

STATE_UNITS: Mapping[str, str] = {
    **{state.name: state.unit for model in SYSTEM_MODELS.values() for state in model.states},
    "s": "m",
    "lateral": "m",
    "heading": "rad",
}
"""Units of the states of all system models, and of the coordinates along a corridor's path."""
COMMAND_UNITS: Mapping[str, str] = {"v": "m/s", "omega": "rad/s", "T_1": "N", "T_2": "N"}
"""Commands of the bodies: speeds of a differential drive, thrusts of a planar quadrotor."""
BODY_RADII: Mapping[str, float] = {"turtlebot3_burger": 0.123, "turtlebot2": 0.177, "planar_quadrotor": 0.4191}
"""Circle around a body's origin that holds all of it [m]."""


Steps = Annotated[int, Field(gt=0, le=10_000_000)]
Samples = Annotated[int, Field(gt=0, le=10_000_000_000)]
Reward = Annotated[float, Field(ge=-1e9, le=1e9)]
Weight = Annotated[float, Field(gt=0.0, le=1e9)]
_Entry = TypeVar("_Entry")
Several = Annotated[tuple[_Entry, ...], Strict(False), Field(max_length=10_000)]
"""A list of the file, which does not change after reading."""


class Part(Schema):
    """A part of a task file: unknown keys are errors, nothing changes after reading."""


class TaskHeader(Part):
    """What every task file starts with.

    Attributes:
        name: the file's name without suffix.
        about: what the robot is to do, in a sentence.
        source: where it comes from (thesis section, published code).
        differences: each point in which thesis, published code and this file differ, and which one is used.
    """

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    about: str
    source: str
    differences: Several[str] = ()


def _intervals(units: Mapping[str, str]) -> BeforeValidator:
    """Read a mapping from names to intervals, each in the unit of its name."""

    def parse(value: Any) -> dict[str, Interval]:
        if not isinstance(value, dict):
            raise ValueError("must be a mapping from names to intervals, e.g. {x: 0.0 .. 1.0 m}")
        out = {}
        for name, text in value.items():
            unit = _unit_of(name, units)
            try:
                out[name] = parse_interval(text, unit)
            except ValueError as error:
                raise ValueError(f"{short_repr(name)}: {error}") from None
        return out

    return BeforeValidator(parse)


class SystemSpec(Part):
    """The model f of the robot for solvers and MPC (thesis Table 3.1).

    Attributes:
        model: a name of `ctrl_rl_core.systems.system`.
        parameters: by name, with units; the model's defaults where left out.
        controls: bounds by control name; the model's defaults where left out.
    """

    model: str
    parameters: dict[str, str] = Field(default_factory=dict)
    controls: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _known(self) -> SystemSpec:
        if self.model not in SYSTEM_MODELS:
            raise ValueError(f"model: no system model {short_repr(self.model)}: there are {', '.join(SYSTEM_MODELS)}")
        self.build()
        return self

    def scaled(self, factors: Mapping[str, float]) -> SystemSpec:
        """Return the same model with some parameters multiplied, by name.

        Raises:
            ValueError: the model has no such parameter, or it cannot have such a value.
        """
        units = {name: _unit_of(name, self._parameter_units()) for name in factors}
        own = self.build().parameters
        changed = {name: f"{factor * own[name]!r} {units[name]}" for name, factor in factors.items()}
        return SystemSpec(model=self.model, parameters={**self.parameters, **changed}, controls=self.controls)

    def _parameter_units(self) -> dict[str, str]:
        return {parameter.name: parameter.unit for parameter in SYSTEM_MODELS[self.model].parameters}

    def build(self) -> System:
        """Return the system model with this task's parameters and control bounds."""
        model = SYSTEM_MODELS[self.model]
        parameter_units = self._parameter_units()
        control_units = {control.name: control.unit for control in model.controls}
        parameters = {
            name: parse_scalar(text, _unit_of(name, parameter_units)) for name, text in self.parameters.items()
        }
        controls = {name: parse_interval(text, _unit_of(name, control_units)) for name, text in self.controls.items()}
        try:
            return make_system(self.model, parameters=parameters, control_bounds=controls)
        except SystemModelError as error:
            raise ValueError(str(error)) from None


def _unit_of(name: str, units: Mapping[str, str]) -> str:
    if name not in units:
        raise ValueError(f"{short_repr(name)}: no such name; there are {', '.join(units) or 'none'}")
    return units[name]


class RobotSpec(Part):
    """The body that carries out the commands.

    Attributes:
        body: URDF of `sim_bridge`.
        commands: what a policy may command, by name; narrower than what the body can do.
        tilt_limit: pitch beyond which a flying body counts as crashed [rad].
    """

    body: Literal["turtlebot3_burger", "turtlebot2", "planar_quadrotor"]
    commands: Annotated[dict[str, Interval], _intervals(COMMAND_UNITS)]
    tilt_limit: Angle | None = None

    @model_validator(mode="after")
    def _of_the_body(self) -> RobotSpec:
        wanted = ("T_1", "T_2") if self.body == "planar_quadrotor" else ("v", "omega")
        if tuple(self.commands) != wanted:
            there = ", ".join(self.commands) or "none"
            raise ValueError(f"commands: are {there}, must be {' and '.join(wanted)}, in this order, for {self.body}")
        return self

    @property
    def radius(self) -> float:
        """Of a circle around the body's origin that holds all of it [m]."""
        return BODY_RADII[self.body]


class ArenaSpec(Part):
    """The rectangle that the robot stays in: x, and y or z; walls of the given thickness stand around it."""

    x: LengthInterval
    y: LengthInterval | None = None
    z: LengthInterval | None = None
    wall_thickness: PositiveLength

    @model_validator(mode="after")
    def _two_axes(self) -> ArenaSpec:
        if (self.y is None) == (self.z is None):
            raise ValueError("needs 'x' and either 'y' or 'z'")
        return self

    @property
    def bounds(self) -> tuple[Interval, Interval]:
        """The two intervals of the plane [m]."""
        second = self.y if self.y is not None else self.z
        assert second is not None
        return self.x, second

    def walls(self) -> tuple[Box, ...]:
        """Return the four walls."""
        return frame_walls(*self.bounds, self.wall_thickness)


class StraightSpec(Part):
    """A straight piece of path."""

    straight: PositiveLength

    def arc(self) -> Arc:
        """Return the piece."""
        return Arc(self.straight, 0.0)


class TurnSpec(Part):
    """A turn by an angle, positive to the left, at a radius."""

    turn: Angle
    radius: PositiveLength

    def arc(self) -> Arc:
        """Return the piece."""
        return Arc(abs(self.turn) * self.radius, math.copysign(1.0 / self.radius, self.turn))


class CorridorSpec(Part):
    """Two walls along a path; closed behind the start, open at the end.

    Regions of such a task are in path coordinates: s along it [m], lateral to the left of it [m], heading
    relative to it [rad].
    """

    pieces: Several[StraightSpec | TurnSpec] = Field(min_length=1, max_length=1000)
    width: PositiveLength
    width_range: LengthInterval
    wall_thickness: PositiveLength

    @model_validator(mode="after")
    def _fits(self) -> CorridorSpec:
        if self.width not in self.width_range:
            raise ValueError("width: lies outside width_range")
        self.walls(self.width_range.high)
        return self

    @property
    def path(self) -> ArcPath:
        """The middle line."""
        return ArcPath(tuple(piece.arc() for piece in self.pieces))

    def walls(self, width: float) -> tuple[Box, ...]:
        """Return the walls at a free width [m], with the one behind the start."""
        cap = Box((-0.5 * self.wall_thickness, 0.0), (self.wall_thickness, width + 2 * self.wall_thickness))
        return (cap, *self.path.walls(width, self.wall_thickness))


class BoxSpec(Part):
    """A box by centre and size."""

    centre: Point
    size: Point


class DiscSpec(Part):
    """A disc by centre and radius."""

    centre: Point
    radius: PositiveLength


class ObstacleSpec(Part):
    """A fixed obstacle: a box or a disc."""

    box: BoxSpec | None = None
    disc: DiscSpec | None = None

    @model_validator(mode="after")
    def _one(self) -> ObstacleSpec:
        if (self.box is None) == (self.disc is None):
            raise ValueError("needs either 'box' or 'disc'")
        return self

    @property
    def shape(self) -> Shape:
        """Its geometry."""
        if self.box is not None:
            return Box(self.box.centre, self.box.size)
        assert self.disc is not None
        return Disc(self.disc.centre, self.disc.radius)


class RegionSpec(Part):
    """A set of states: intervals by state name, and optionally a disc of positions."""

    disc: DiscSpec | None = None
    intervals: Annotated[dict[str, Interval], _intervals(STATE_UNITS)] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            raise ValueError("must be a mapping from state names to intervals")
        rest = {name: text for name, text in value.items() if name != "disc"}
        return {"intervals": rest} | ({"disc": value["disc"]} if "disc" in value else {})

    @property
    def region(self) -> Region:
        """The set itself."""
        disc = None if self.disc is None else Disc(self.disc.centre, self.disc.radius)
        return Region(self.intervals, disc)


class EpisodeSpec(Part):
    """How long an episode is: steps of a policy, and what a step lasts."""

    steps: Steps
    time_step: TimeStep


class RewardSpec(Part):
    """What the task pays (thesis Eq. 3.9, 3.15, 3.17)."""

    goal: Reward
    collision: Reward
    intermediate: Reward = 0.0
    trap: Reward | None = None
    timeout: Reward = 0.0
    tilt: Reward | None = None


class LidarSpec(Part):
    """Range beams, evenly spread over the field of view, counter-clockwise.

    Attributes:
        beams: how many.
        field: of view; where it is a whole turn the last beam does not repeat the first.
        placement: beams at the `edges` of the field, first beam first, or at `centres` of equal sectors.
        range: least and largest distance measured [m].
        rate: scans per second [Hz].
        noise: standard deviation of a range [m].
        dropout: probability that a beam returns nothing.
    """

    beams: int = Field(gt=0, le=10_000)
    field: AngleInterval
    placement: Literal["edges", "centres"] = "edges"
    range: LengthInterval
    rate: PositiveRate
    noise: Length = 0.0
    dropout: float = Field(default=0.0, ge=0.0, lt=1.0)

    @property
    def angle_min(self) -> float:
        """Bearing of the first beam [rad]."""
        return self.field.low + (0.5 * self.angle_increment if self.placement == "centres" else 0.0)

    @property
    def angle_increment(self) -> float:
        """Angle from beam to beam [rad]."""
        whole_turn = math.isclose(self.field.length, 2 * math.pi)
        gaps = self.beams if whole_turn or self.placement == "centres" else max(1, self.beams - 1)
        return self.field.length / gaps


class GridSpec(Part):
    """One axis of the published value grid: nodes over an interval."""

    interval: str
    count: int = Field(gt=1, le=100_000)


class OptimalControlSpec(Part):
    """Constants of the MPC problem (thesis Eq. 3.16, with the trap term of section 3.3.3).

    Attributes:
        horizon: H, steps.
        time_step: [s].
        gamma: growth of the state cost per step.
        discount: of a step of the policy, in the value function (Eq. 3.13) and in learning with it.
        state_weight: Q on the squared distance to the goal.
        control_weight: R on the squared controls.
        trap_weight: W on the squared distance to the trap's middle.
        clearance: least distance from the robot's position to an obstacle, d_min [m].
        trajectories: how many solved trajectories make the value data.
        controls: bounds by control name.
        bounds: by state name.
        terminal_set: where a trajectory must end, by state name; the goal where left out.
    """

    horizon: int = Field(gt=0, le=10_000)
    time_step: TimeStep
    gamma: float = Field(gt=0, le=10)
    discount: float = Field(gt=0, le=1)
    state_weight: Weight
    control_weight: Weight
    trap_weight: float = Field(default=0.0, ge=0, le=1e9)
    clearance: Length
    trajectories: Steps
    controls: Annotated[dict[str, Interval], _intervals(COMMAND_UNITS)]
    bounds: Annotated[dict[str, Interval], _intervals(STATE_UNITS)]
    terminal_set: RegionSpec | None = None

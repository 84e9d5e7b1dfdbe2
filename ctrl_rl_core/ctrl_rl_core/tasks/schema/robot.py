"""The robot of a task file: its body, the commands that a policy may give it, and its lidar."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ctrl_rl_core.geometry.units import (
    Angle,
    AngleInterval,
    Interval,
    Length,
    LengthInterval,
    PositiveLength,
    PositiveRate,
)
from ctrl_rl_core.tasks.schema.parts import Part, interval_map
from ctrl_rl_core.tasks.schema.system import CONTROL_UNITS

MODEL = "model"
"""Name of the body that is a disc and moves exactly as the task's system model says."""


@dataclass(frozen=True)
class Body:
    """Size and commands of a robot's body.

    Attributes:
        radius: Radius of a circle around the body's origin that holds all of it [m].
        commands: Names of its commands, in the order of messages.
    """

    radius: float
    commands: tuple[str, str]


BODIES: Mapping[str, Body] = {
    "turtlebot3_burger": Body(0.123, ("v", "omega")),
    "turtlebot2": Body(0.177, ("v", "omega")),
    "jackal": Body(0.333, ("v", "omega")),
    "planar_quadrotor": Body(0.4191, ("T_1", "T_2")),
}
"""The bodies that `sim_bridge` has a URDF of."""


class RobotSpec(Part):
    """The body that carries out the commands.

    Attributes:
        body: Name of the body in `BODIES`, or `MODEL`.
        commands: Bounds of a policy's commands by name, within those of the body; of a model its two controls.
        footprint: Radius of the disc that a model is [m]; other bodies have their own size.
        tilt_limit: Pitch beyond which a flying body counts as crashed [rad].
    """

    body: Literal["turtlebot3_burger", "turtlebot2", "jackal", "planar_quadrotor", "model"]
    commands: Annotated[dict[str, Interval], interval_map(CONTROL_UNITS)]
    footprint: PositiveLength | None = None
    tilt_limit: Angle | None = None

    @model_validator(mode="after")
    def _of_the_body(self) -> RobotSpec:
        if (self.body == MODEL) != (self.footprint is not None):
            raise ValueError("footprint: is the radius of a body 'model', e.g. 0.2 m; other bodies have their own size")
        if self.body == MODEL:
            return self
        wanted = BODIES[self.body].commands
        if tuple(self.commands) != wanted:
            there = ", ".join(self.commands) or "none"
            raise ValueError(f"commands: are {there}, must be {' and '.join(wanted)}, in this order, for {self.body}")
        return self

    @property
    def radius(self) -> float:
        """Radius of a circle around the body's origin that holds all of it [m]."""
        return BODIES[self.body].radius if self.footprint is None else self.footprint


class LidarSpec(Part):
    """Range beams, evenly spread over the field of view, counter-clockwise.

    Attributes:
        beams: Number of beams in a scan.
        field: Field of view [rad]; the last beam of a whole turn does not repeat the first.
        placement: Bearings of the beams, at the `edges` of the field, or at `centres` of equal sectors.
        range: Least and largest distance measured [m].
        rate: Scans per second [Hz].
        noise: Standard deviation of a range [m].
        dropout: Probability that a beam returns nothing.
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

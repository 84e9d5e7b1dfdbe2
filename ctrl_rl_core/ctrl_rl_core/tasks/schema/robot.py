"""The robot of a task file: its body, and the commands that a policy may give it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import model_validator

from ctrl_rl_core.geometry.units import Angle, Interval
from ctrl_rl_core.tasks.schema.parts import Part, interval_map

COMMAND_UNITS: Mapping[str, str] = {"v": "m/s", "omega": "rad/s", "T_1": "N", "T_2": "N"}
"""Commands of the bodies: speeds of a differential drive, thrusts of a planar quadrotor."""


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
    "planar_quadrotor": Body(0.4191, ("T_1", "T_2")),
}
"""The bodies that `sim_bridge` has a URDF of."""


class RobotSpec(Part):
    """The body that carries out the commands.

    Attributes:
        body: Name of the body in `BODIES`.
        commands: Bounds of a policy's commands by name, within those of the body.
        tilt_limit: Pitch beyond which a flying body counts as crashed [rad].
    """

    body: Literal["turtlebot3_burger", "turtlebot2", "planar_quadrotor"]
    commands: Annotated[dict[str, Interval], interval_map(COMMAND_UNITS)]
    tilt_limit: Angle | None = None

    @model_validator(mode="after")
    def _of_the_body(self) -> RobotSpec:
        wanted = BODIES[self.body].commands
        if tuple(self.commands) != wanted:
            there = ", ".join(self.commands) or "none"
            raise ValueError(f"commands: are {there}, must be {' and '.join(wanted)}, in this order, for {self.body}")
        return self

    @property
    def radius(self) -> float:
        """Radius of a circle around the body's origin that holds all of it [m]."""
        return BODIES[self.body].radius

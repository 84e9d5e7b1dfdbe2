"""The robot of a task file: its body and the range of policy commands."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from ctrl_rl_core.geometry.units import Angle, Interval, PositiveLength
from ctrl_rl_core.robots.lidar import LidarSpec as LidarSpec
from ctrl_rl_core.robots.robot import Robot, RobotError, find_robot, robot_file
from ctrl_rl_core.tasks.schema.parts import Part, interval_map
from ctrl_rl_core.tasks.schema.system import CONTROL_UNITS

MODEL = "model"
"""Name of the body that is a disc moving exactly as the task's system model."""
_WORD = re.compile(r"\brobot\b")


class RobotSpec(Part):
    """The body that executes the commands.

    Attributes:
        body: Name of a robot, path of its file relative to the task file, or `MODEL`.
        commands: Bounds of a policy's commands by name; by default the robot's limits. For `MODEL`, bounds of its two
            controls.
        footprint: Radius of the disc for `MODEL` [m]; other bodies have their own size.
        tilt_limit: Pitch beyond which a flying body counts as crashed [rad].
    """

    body: str = Field(max_length=4000)
    commands: Annotated[dict[str, Interval], interval_map(CONTROL_UNITS)]
    footprint: PositiveLength | None = None
    tilt_limit: Angle | None = None
    _robot: Robot | None = PrivateAttr(None)

    @model_validator(mode="before")
    @classmethod
    def _own_commands(cls, value: Any, info: ValidationInfo) -> Any:
        """Use the robot's limits if no commands are given."""
        robot = named_robot(value, info)
        if robot is None or not robot.on_wheels or "commands" in value:
            return value
        return {**value, "commands": dict(zip(robot.commands, limits_of(robot), strict=True))}

    @field_validator("body")
    @classmethod
    def _found(cls, value: str, info: ValidationInfo) -> str:
        """Reject an unknown robot, and make a path absolute."""
        if value == MODEL:
            return value
        try:
            find_robot(value, _folder(info))
        except RobotError as error:
            raise ValueError(f"{error}, or '{MODEL}'") from None
        return str(robot_file(value, _folder(info)).resolve()) if value.endswith((".yaml", ".yml")) else value

    @model_validator(mode="after")
    def _of_the_body(self) -> RobotSpec:
        if (self.body == MODEL) != (self.footprint is not None):
            raise ValueError("footprint: is the radius of a body 'model', e.g. 0.2 m; other bodies have their own size")
        if self.body == MODEL:
            return self
        self._robot = find_robot(self.body)
        wanted = self._robot.commands
        if tuple(self.commands) != wanted:
            there = ", ".join(self.commands) or "none"
            raise ValueError(f"commands: are {there}, must be {' and '.join(wanted)}, in this order, for {self.body}")
        return self

    @property
    def robot(self) -> Robot | None:
        """The robot; None for a model."""
        return self._robot

    @property
    def radius(self) -> float:
        """Radius of a circle around the body's origin that encloses the body [m]."""
        if self.footprint is not None:
            return self.footprint
        assert self._robot is not None
        return self._robot.radius


def named_robot(content: Any, info: ValidationInfo) -> Robot | None:
    """Return the robot named in the `robot` part; None for a model or an invalid part, which is reported later."""
    body = content.get("body") if isinstance(content, dict) else None
    if not isinstance(body, str) or body == MODEL:
        return None
    try:
        return find_robot(body, _folder(info))
    except RobotError:
        return None


def limits_of(robot: Robot) -> tuple[str, str]:
    """Return the commands that a wheeled robot can execute, in task-file notation."""
    (back, right), (ahead, left) = robot.limits
    return f"{back} .. {ahead} m/s", f"{right} .. {left} rad/s"


def with_limits(controls: dict[str, Any], robot: Robot) -> dict[str, Any]:
    """Replace the word `robot` in bounds of controls by the robot's limits, as in `v: 0.0 .. robot m/s`."""
    limits = {"v": robot.speed, "omega": robot.turn_rate}
    return {
        name: _WORD.sub(str(limits[name]), text) if isinstance(text, str) and name in limits else text
        for name, text in controls.items()
    }


def _folder(info: ValidationInfo) -> Path | None:
    folder: Path | None = (info.context or {}).get("folder")
    return folder

"""Declarative node parameters: name, default, meaning and range, used for checks, descriptors and --help."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.robots.robot import DEFAULT_ROBOT, Robot, RobotError, find_robot

_LARGEST_FLOAT = 1.7976931348623157e308
_LARGEST_INT = 2**63 - 1
LONGEST_TEXT = 4096
"""Maximum length of a text: the longest path."""
LONGEST_LIST = 1000
_LONGEST_PART = 240
"""Maximum length of a path component: file systems allow 255 bytes, including a suffix added later."""
_ROS_NAME = re.compile(r"(~(?=/|$))?/?([A-Za-z_{][A-Za-z0-9_{}]*(/[A-Za-z_{][A-Za-z0-9_{}]*)*/?)?", re.ASCII)
_KINDS = {bool: "true or false", int: "a whole number", float: "a number, written with a point", str: "a text"}


ROBOT_MEANING = "Robot that is driven: turtlebot3_burger, turtlebot2, turtlebot4, jackal, or a .yaml file."


class ParameterError(CtrlRlError):
    """A node parameter has a wrong type, is out of range or contradicts another one."""


@dataclass(frozen=True)
class Parameter:
    """A node parameter; its type is that of the default.

    Attributes:
        name: Name, as in `-p name:=value`.
        default: Default value.
        description: Meaning, with the unit in brackets.
        minimum: Minimum value; None for no bound.
        maximum: Maximum value; None for no bound.
        choices: Allowed texts; empty for any.
        live: Whether `ros2 param set` may change it while the node runs.
        kind: Meaning of a text: arbitrary; the name or path of a file, with `~` for the home folder; a ROS name; or the
            name or file of a robot.
        of_robot: Robot attribute, such as `lidar.x`, that provides the default; the robot is given by the node's
            parameter of kind `robot`. Empty if the default is the same for all robots.
    """

    name: str
    default: Any
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    live: bool = False
    kind: Literal["text", "path", "name", "robot"] = "text"
    of_robot: str = ""

    @property
    def limits(self) -> str:
        """The allowed values in words; empty if every value of the type is allowed."""
        if self.choices:
            return "one of: " + ", ".join(self.choices)
        match self.minimum, self.maximum:
            case None, None:
                return ""
            case low, None:
                return f"at least {low:g}"
            case None, high:
                return f"at most {high:g}"
            case low, high:
                return f"{low:g} to {high:g}"

    def descriptor(self) -> ParameterDescriptor:
        """Return the descriptor shown by `ros2 param describe`."""
        out = ParameterDescriptor(name=self.name, description=self.description, read_only=not self.live)
        out.additional_constraints = self.limits
        if self.minimum is None and self.maximum is None:
            return out
        low, high = self.minimum, self.maximum
        if isinstance(self.default, int):
            whole = (-_LARGEST_INT if low is None else int(low), _LARGEST_INT if high is None else int(high))
            out.integer_range = [IntegerRange(from_value=whole[0], to_value=whole[1])]
        else:
            real = (-_LARGEST_FLOAT if low is None else float(low), _LARGEST_FLOAT if high is None else float(high))
            out.floating_point_range = [FloatingPointRange(from_value=real[0], to_value=real[1])]
        return out

    def check(self, value: Any) -> Any:
        """Validate `value` and convert it to the form that the node uses.

        Raises:
            ParameterError: The value has another type, is not finite, is not one of the choices, is too long, or is not
                a valid name or path.
        """
        kind = type(self.default)
        if not (isinstance(value, kind) or (kind is list and isinstance(value, tuple))) or (
            isinstance(value, bool) and kind is not bool
        ):
            raise self._wrong(_shown(value))
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(f"parameter '{self.name}' must be a finite number, not {value}: {self.description}")
        if self.choices and value not in self.choices:
            raise ParameterError(f"parameter '{self.name}' is '{_shown(value)}': must be {self.limits}")
        if isinstance(value, str):
            return self._text(value)
        if isinstance(value, list | tuple):
            if len(value) > LONGEST_LIST:
                raise ParameterError(f"parameter '{self.name}' has {len(value)} entries: at most {LONGEST_LIST}")
            return [self._text(each) for each in value]
        return value

    def _text(self, text: str) -> str:
        if len(text) > LONGEST_TEXT:
            raise ParameterError(f"parameter '{self.name}' has {len(text)} letters: at most {LONGEST_TEXT}")
        if not text.isprintable():
            raise ParameterError(f"parameter '{self.name}' has letters that cannot be printed: {_shown(text)!a}")
        if self.kind == "name" and not _ROS_NAME.fullmatch(text):
            raise ParameterError(
                f"parameter '{self.name}': '{_shown(text)}' is no name of ROS: use letters, digits, _ and /"
            )
        if self.kind in ("path", "robot"):
            longest = max(map(len, text.split("/")))
            if longest > _LONGEST_PART:
                raise ParameterError(
                    f"parameter '{self.name}': a part of the path has {longest} letters: at most {_LONGEST_PART}"
                )
            return os.path.expanduser(text)
        return text

    def _wrong(self, given: str) -> ParameterError:
        kind = _KINDS.get(type(self.default), "a list, [..., ...]")
        return ParameterError(f"parameter '{self.name}' is {given}: must be {kind}: {self.description}")

    def _given(self, value: Any) -> Any:
        """Return the value given at startup, converted where YAML read a text as a number or has no type for a list."""
        if isinstance(self.default, list) and value in (None, []):
            return [""]
        if isinstance(self.default, str) and isinstance(value, float) and not math.isfinite(value):
            return str(value)
        if value is None:
            raise self._wrong("not set")
        return value


def check_all(table: Iterable[Parameter], values: Mapping[str, Any]) -> dict[str, Any]:
    """Validate those `values` that are in the table.

    Raises:
        ParameterError: A value is not allowed.
    """
    return {each.name: each.check(values[each.name]) for each in table if each.name in values}


def declare(node: Node, table: Iterable[Parameter]) -> dict[str, Any]:
    """Declare a table of parameters on a node and return their values by name.

    Raises:
        ParameterError: A value given at startup has a wrong type or is not allowed.
    """
    values: dict[str, Any] = {}
    robot: Robot | None = None
    overrides = node._parameter_overrides
    for parameter in sorted(table, key=lambda each: each.kind != "robot"):
        if parameter.of_robot and robot is not None:
            parameter = replace(parameter, default=of_robot(robot, parameter.of_robot))
        given = overrides.get(parameter.name)
        if given is not None:
            overrides[parameter.name] = RosParameter(parameter.name, value=parameter._given(given.value))
        try:
            value = node.declare_parameter(parameter.name, parameter.default, parameter.descriptor()).value
        except InvalidParameterTypeException:
            raise parameter._wrong(f"'{_shown(overrides[parameter.name].value)}'") from None
        except InvalidParameterValueException:
            raise ParameterError(
                f"parameter '{parameter.name}' is out of range: must be {parameter.limits}: {parameter.description}"
            ) from None
        values[parameter.name] = parameter.check(value)
        if parameter.kind == "robot":
            try:
                robot = find_robot(values[parameter.name])
            except RobotError as error:
                raise ParameterError(f"parameter '{parameter.name}': {error}") from None
    return values


def robot_parameter(
    name: str,
    attribute: str,
    description: str,
    minimum: float | None = None,
    maximum: float | None = None,
    live: bool = False,
) -> Parameter:
    """Return a parameter whose default is an attribute of the node's robot; --help shows that of the default robot.

    Args:
        name: Name of the parameter.
        attribute: Robot attribute that provides the default, such as `lidar.x`.
        description: Meaning, with the unit in brackets.
        minimum: Minimum value; None for no bound.
        maximum: Maximum value; None for no bound.
        live: Whether it may change while the node runs.
    """
    default = of_robot(find_robot(DEFAULT_ROBOT), attribute)
    meaning = f"{description.removesuffix('.')}; that of `robot` unless given."
    return Parameter(name, default, meaning, minimum, maximum, live=live, of_robot=attribute)


def of_robot(robot: Robot, attribute: str) -> float:
    """Return a robot attribute given by a dotted name, such as `lidar.x`."""
    value: Any = robot
    for part in attribute.split("."):
        value = getattr(value, part)
    return float(value)


ROBOT = Parameter("robot", DEFAULT_ROBOT, ROBOT_MEANING, kind="robot")
"""The node's robot, which provides the defaults of other parameters."""


def _shown(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 100 else f"{text[:96]} ..."


def help_text(program: str, description: str, table: Iterable[Parameter]) -> str:
    """Return the --help text of a node."""
    lines = [
        f"usage: {program} [--ros-args -p NAME:=VALUE ... -r FROM:=TO ...]",
        "",
        description.strip(),
        "",
        "parameters:",
    ]
    for parameter in table:
        default = repr(parameter.default) if isinstance(parameter.default, str) else str(parameter.default).lower()
        notes = [f"default {default}", parameter.limits, "may change while running" if parameter.live else ""]
        lines += [f"  {parameter.name}", f"      {parameter.description} ({'; '.join(n for n in notes if n)})"]
    return "\n".join(lines)

"""Node parameters as a table: name, default, meaning and range, from which checks, descriptors and --help follow."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from ctrl_rl_core.errors import CtrlRlError

_LARGEST_FLOAT = 1.7976931348623157e308
_LARGEST_INT = 2**63 - 1
_KINDS = {bool: "true or false", int: "a whole number", float: "a number, written with a point", str: "a text"}


class ParameterError(CtrlRlError):
    """A node parameter has a wrong type, lies outside its range or contradicts another one."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a node; its type is that of the default.

    Attributes:
        name: as on the command line, `-p name:=value`.
        default: the one default.
        description: meaning, with the unit in brackets.
        minimum: least value allowed, None for no bound.
        maximum: largest value allowed, None for no bound.
        choices: the texts allowed; empty for any.
        live: whether `ros2 param set` may change it while the node runs.
    """

    name: str
    default: Any
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    live: bool = False

    @property
    def limits(self) -> str:
        """What is allowed, in words; empty where everything of the type is."""
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
        """Return what `ros2 param describe` shows."""
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

    def check(self, value: Any) -> None:
        """Raise ParameterError where `value` is no finite number or not one of the choices."""
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(f"parameter '{self.name}' must be a finite number, not {value}: {self.description}")
        if self.choices and value not in self.choices:
            raise ParameterError(f"parameter '{self.name}' is '{value}': must be {self.limits}")


def declare(node: Node, table: Iterable[Parameter]) -> dict[str, Any]:
    """Declare a table of parameters on a node and return their values by name.

    Raises:
        ParameterError: a value given at start has a wrong type or is not allowed.
    """
    values: dict[str, Any] = {}
    for parameter in table:
        try:
            value = node.declare_parameter(parameter.name, parameter.default, parameter.descriptor()).value
        except InvalidParameterTypeException as error:
            given = str(error).partition("' to ")[2].partition(" of type")[0]
            kind = _KINDS.get(type(parameter.default), "a list, [..., ...]")
            raise ParameterError(
                f"parameter '{parameter.name}' is {given}: must be {kind}: {parameter.description}"
            ) from None
        except InvalidParameterValueException:
            raise ParameterError(
                f"parameter '{parameter.name}' is out of range: must be {parameter.limits}: {parameter.description}"
            ) from None
        parameter.check(value)
        values[parameter.name] = value
    return values


def help_text(program: str, description: str, table: Iterable[Parameter]) -> str:
    """Return what --help prints for a node."""
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

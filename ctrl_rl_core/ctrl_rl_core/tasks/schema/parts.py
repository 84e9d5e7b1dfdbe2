"""Base class of all parts of a task file, its header, its rewards, and shared types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, Field, Strict

from ctrl_rl_core.geometry.units import Interval, TimeStep, parse_interval
from ctrl_rl_core.io.file_checks import short_repr
from ctrl_rl_core.io.schema import Schema

Steps = Annotated[int, Field(gt=0, le=10_000_000)]
Samples = Annotated[int, Field(gt=0, le=10_000_000_000)]
Reward = Annotated[float, Field(ge=-1e9, le=1e9)]
Weight = Annotated[float, Field(gt=0.0, le=1e9)]
_Entry = TypeVar("_Entry")
Several = Annotated[tuple[_Entry, ...], Strict(False), Field(max_length=10_000)]
"""A list in the file, immutable after reading."""


class Part(Schema):
    """A part of a task file: unknown keys are errors; immutable after reading."""


class TaskHeader(Part):
    """Header of every task file.

    Attributes:
        name: File name without suffix.
        about: One sentence on what the robot has to do.
        source: Origin of the task (thesis section, published code).
        differences: Differences between thesis, published code and this file, each with the choice made.
    """

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    about: str
    source: str
    differences: Several[str] = ()


def interval_map(units: Mapping[str, str]) -> BeforeValidator:
    """Return a validator for a mapping from names to intervals, each in the unit of its name."""

    def parse(value: Any) -> dict[str, Interval]:
        if not isinstance(value, dict):
            raise ValueError("must be a mapping from names to intervals, e.g. {x: 0.0 .. 1.0 m}")
        out = {}
        for name, text in value.items():
            unit = unit_of(name, units)
            try:
                out[name] = parse_interval(text, unit)
            except ValueError as error:
                raise ValueError(f"{short_repr(name)}: {error}") from None
        return out

    return BeforeValidator(parse)


def unit_of(name: str, units: Mapping[str, str]) -> str:
    """Return the unit of a name.

    Raises:
        ValueError: The name is unknown.
    """
    if name not in units:
        raise ValueError(f"{short_repr(name)}: no such name; there are {', '.join(units) or 'none'}")
    return units[name]


class EpisodeSpec(Part):
    """Maximum number of policy steps in an episode, and the duration of a step."""

    steps: Steps
    time_step: TimeStep


class RewardSpec(Part):
    """Rewards of a task by the outcome of a step (thesis Eq. 3.9, 3.15, 3.17)."""

    goal: Reward
    collision: Reward
    intermediate: Reward = 0.0
    trap: Reward | None = None
    timeout: Reward = 0.0
    tilt: Reward | None = None

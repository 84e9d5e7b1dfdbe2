"""Ranges from which each episode in the simulator draws what differs from robot to robot, and is not known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator

from ctrl_rl_core.geometry.units import Interval
from ctrl_rl_core.tasks.schema.parts import interval_map


@dataclass(frozen=True)
class Condition:
    """One number that an episode may draw.

    Attributes:
        unit: SI unit of the number.
        allowed: Least and largest value.
        wheels: Whether it is about wheels.
    """

    unit: str
    allowed: Interval
    wheels: bool = False


CONDITIONS: Mapping[str, Condition] = {
    "friction": Condition("1", Interval(0.01, 10.0), wheels=True),
    "wheel_radius": Condition("1", Interval(0.5, 2.0), wheels=True),
    "motor_lag": Condition("s", Interval(0.001, 5.0), wheels=True),
    "command_delay": Condition("s", Interval(0.0, 2.0)),
    "scan_noise": Condition("m", Interval(0.0, 1.0)),
    "scan_dropout": Condition("1", Interval(0.0, 1.0)),
    "odom_drift": Condition("1", Interval(0.0, 0.5)),
}
"""Options of the simulation by name; `friction` is that of wheels on the floor, `wheel_radius` true over nominal."""


def _within_limits(ranges: dict[str, Interval]) -> dict[str, Interval]:
    for name, (low, high) in ranges.items():
        allowed = CONDITIONS[name].allowed
        if low < allowed.low or high > allowed.high:
            raise ValueError(f"'{name}' {low:g} .. {high:g}: must be within {allowed.low:g} .. {allowed.high:g}")
    return ranges


Randomisation = Annotated[
    dict[str, Interval],
    AfterValidator(_within_limits),
    interval_map({name: condition.unit for name, condition in CONDITIONS.items()}),
]

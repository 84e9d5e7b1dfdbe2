"""Randomised simulation parameters: quantities that vary between robots and are unknown, drawn per episode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator

from ctrl_rl_core.geometry.units import Interval
from ctrl_rl_core.tasks.schema.parts import interval_map


@dataclass(frozen=True)
class Condition:
    """One quantity that may be drawn per episode.

    Attributes:
        unit: SI unit.
        allowed: Minimum and maximum.
        wheels: Whether it concerns wheels.
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
"""Simulation parameters by name; `friction`: wheels on floor, `wheel_radius`: ratio of true to nominal."""


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

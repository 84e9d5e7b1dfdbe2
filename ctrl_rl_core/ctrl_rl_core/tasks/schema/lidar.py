"""The lidar of a task file."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from ctrl_rl_core.geometry.units import AngleInterval, Length, LengthInterval, PositiveRate
from ctrl_rl_core.tasks.schema.parts import Part


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

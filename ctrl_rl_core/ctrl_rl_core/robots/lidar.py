"""A lidar: its beams and its mounting position."""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import Field, model_validator

from ctrl_rl_core.geometry.units import Angle, AngleInterval, Length, LengthInterval, PositiveRate
from ctrl_rl_core.io.schema import Schema


class LidarSpec(Schema):
    """Range beams, evenly spaced over the field of view, counter-clockwise.

    Attributes:
        beams: Number of beams in a scan.
        field: Field of view [rad]; in a full turn, the last beam does not repeat the first.
        placement: Placement of the beams: from edge to edge of the field (`edges`), or at the `centres` of equal
            sectors.
        range: Minimum and maximum measured distance [m].
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
        """Angle between beams [rad]."""
        whole_turn = math.isclose(self.field.length, 2 * math.pi)
        gaps = self.beams if whole_turn or self.placement == "centres" else max(1, self.beams - 1)
        return self.field.length / gaps


class MountedLidar(Schema):
    """A lidar on its robot; a file without beam data leaves them to the task.

    Attributes:
        x: Position ahead of the robot's centre [m].
        y: Position to the left of the centre [m].
        z: Height above the floor [m].
        yaw: Direction of its zero bearing, counter-clockwise from ahead [rad].
        missing_rate: Probability that a scan misses what its beams hit, as the safety filter assumes it.
        spec: Beam data; None if the file has none.
    """

    x: Length = Field(default=0.0, ge=-1.0, le=1.0)
    y: Length = Field(default=0.0, ge=-1.0, le=1.0)
    z: Length = Field(default=0.0, ge=0.0, le=3.0)
    yaw: Angle = Field(default=0.0, ge=-math.pi, le=math.pi)
    missing_rate: float = Field(default=0.1, ge=0.0, le=0.5)
    spec: LidarSpec | None = None

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, value: Any) -> Any:
        if not isinstance(value, dict) or "spec" in value:
            return value
        beams = {name: part for name, part in value.items() if name in LidarSpec.model_fields}
        place = {name: part for name, part in value.items() if name not in beams}
        return place | ({"spec": beams} if beams else {})

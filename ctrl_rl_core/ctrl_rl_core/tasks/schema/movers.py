"""Moving obstacles of a task file: upright cylinders that follow a track, wander, or play key frames."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

from pydantic import Field, model_validator

from ctrl_rl_core.geometry.motion import Motion, catmull_rom
from ctrl_rl_core.geometry.units import (
    Interval,
    Length,
    Point,
    PositiveLength,
    PositiveSpeedInterval,
    Time,
    TimeInterval,
)
from ctrl_rl_core.tasks.schema.parts import Part, Several

MOST_MOVERS = 200
"""Largest number of movers of a task."""


class TrackSpec(Part):
    """Straight lines from point to point, at a constant speed.

    Attributes:
        points: Corners; in a corridor along its path, and to the left of it.
        spread: Each episode draws each point within this distance [m].
        speed: Speeds that each episode draws from [m/s].
        repeat: Behaviour at the last point.
    """

    points: Several[Point] = Field(min_length=2, max_length=1000)
    spread: Length = Field(default=0.0, ge=0.0)
    speed: PositiveSpeedInterval
    repeat: Literal["once", "loop", "back_and_forth"] = "back_and_forth"

    @model_validator(mode="after")
    def _moves(self) -> TrackSpec:
        if all(point == self.points[0] for point in self.points):
            raise ValueError("points: are all the same: a track needs two different ones")
        return self


class WanderSpec(Part):
    """Straight lines between free places of the world, which each episode draws.

    Attributes:
        points: Number of places, after which the mover goes back the same way.
        speed: Speeds that each episode draws from [m/s].
    """

    points: int = Field(default=12, ge=2, le=200)
    speed: PositiveSpeedInterval


class FrameSpec(Part):
    """Where a mover is at a time [s]."""

    time: Time
    point: Point


class KeyframesSpec(Part):
    """A motion by key frames, played as it is: through walls, too.

    Between two frames it follows a Catmull-Rom spline, as Gazebo's animations do.

    Attributes:
        frames: Frames; the first is at 0 s.
        repeat: Whether the motion begins again after the last frame.
    """

    frames: Several[FrameSpec] = Field(min_length=2, max_length=10_000)
    repeat: bool = True

    @model_validator(mode="after")
    def _rising(self) -> KeyframesSpec:
        if self.frames[0].time != 0.0:
            raise ValueError("frames: the first must be at 0 s")
        for one, other in pairwise(self.frames):
            if not one.time < other.time:
                raise ValueError(f"frames: {other.time:g} s follows {one.time:g} s: times must rise")
        return self

    @property
    def motion(self) -> Motion:
        """The motion."""
        return catmull_rom([each.time for each in self.frames], [each.point for each in self.frames], self.repeat)


class MoverSpec(Part):
    """A moving obstacle; nothing that it touches stops it.

    Attributes:
        radius: Radius of the cylinder [m].
        track, wander, keyframes: One of them says where it goes.
        delay: Times before it starts, from which each episode draws [s].
        near: It starts only when a robot's middle comes nearer to its own than this [m]; None to start at once.
        yields: It waits while going on would bring it nearer to a robot than this [m]; None for one that never waits.
    """

    radius: PositiveLength
    track: TrackSpec | None = None
    wander: WanderSpec | None = None
    keyframes: KeyframesSpec | None = None
    delay: TimeInterval = Interval(0.0, 0.0)
    near: PositiveLength | None = None
    yields: PositiveLength | None = None

    @model_validator(mode="after")
    def _one_way(self) -> MoverSpec:
        if [self.track, self.wander, self.keyframes].count(None) != 2:
            raise ValueError("needs either 'track', 'wander' or 'keyframes'")
        return self

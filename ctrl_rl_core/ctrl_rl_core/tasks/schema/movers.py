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
"""Maximum number of movers of a task."""


class TrackSpec(Part):
    """Straight lines between points at a constant speed.

    Attributes:
        points: Corners; in a corridor given along its path and to the left of it.
        spread: Radius within which each episode draws each point [m].
        speed: Range from which each episode draws the speed [m/s].
        repeat: Behaviour at the last point: stop, loop or reverse.
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
    """Straight lines between free positions of the world, drawn for each episode.

    Attributes:
        points: Number of positions, after which the mover returns the same way.
        speed: Range from which each episode draws the speed [m/s].
    """

    points: int = Field(default=12, ge=2, le=200)
    speed: PositiveSpeedInterval


class FrameSpec(Part):
    """Position of a mover at a time [s]."""

    time: Time
    point: Point


class KeyframesSpec(Part):
    """A motion given by key frames, played unchanged, even through walls.

    Frames are joined by a Catmull-Rom spline, as in Gazebo's animations.

    Attributes:
        frames: Key frames; the first is at 0 s.
        repeat: Whether the motion restarts after the last frame.
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
    """A moving obstacle; contacts do not stop it.

    Attributes:
        radius: Radius of the cylinder [m].
        track, wander, keyframes: Motion; exactly one is given.
        delay: Range from which each episode draws the start delay [s].
        near: Distance between a robot's centre and its own that triggers the start [m]; None to start at once.
        yields: Minimum distance to robots, for which the mover waits [m]; None to never wait.
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

"""States with a known V_oc: a collision ends the episode, and Eq. 3.13 gives the task's collision reward.

If a network had to learn these jumps of 1400 between neighbouring states, its error would be hundreds elsewhere, where
values differ by tens. NumPy only; a value file includes its collision set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from ctrl_rl_core.io import Number, Positive, Schema
from ctrl_rl_core.tasks import tilt_reward, wrap
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ctrl_rl_core import Box, Disc, NavigationTask, Shape, position_indices, signed_distance

Array = NDArray[np.float64]


class ShapeHeader(Schema):
    """A shape in a file: [x, y, width, height, angle] of a box or [x, y, radius] of a disc [m, rad]."""

    box: Annotated[list[Number], Field(min_length=5, max_length=5)] | None = None
    disc: Annotated[list[Number], Field(min_length=3, max_length=3)] | None = None

    @model_validator(mode="after")
    def _one(self) -> ShapeHeader:
        if (self.box is None) == (self.disc is None):
            raise ValueError("needs either 'box' or 'disc'")
        if min(self.box[2:4] if self.box else self.disc[2:] if self.disc else [0.0]) <= 0.0:
            raise ValueError("must have an extent")
        return self

    @property
    def shape(self) -> Shape:
        """The shape itself."""
        if self.box is not None:
            x, y, width, height, angle = self.box
            return Box((x, y), (width, height), angle)
        x, y, radius = self.disc or (0.0, 0.0, 0.0)
        return Disc((x, y), radius)


class CollisionHeader(Schema):
    """A `CollisionSet` in a file."""

    shapes: Annotated[list[ShapeHeader], Field(min_length=1, max_length=10_000)]
    radius: Positive
    reward: Number
    tilt_limit: Positive | None
    tilt_reward: Number


@dataclass(frozen=True)
class CollisionSet:
    """States in which the body, a disc, touches a wall or an obstacle, or exceeds the tilt limit.

    Attributes:
        shapes: Walls and obstacles.
        radius: Radius of the robot's body [m].
        reward: Reward of a collision.
        tilt_limit: Maximum |psi| [rad]; infinite for none.
        tilt_reward: Reward beyond the tilt limit.
    """

    shapes: tuple[Shape, ...]
    radius: float
    reward: float
    tilt_limit: float
    tilt_reward: float

    @classmethod
    def of(cls, task: NavigationTask) -> CollisionSet:
        """Create the collision set of a task."""
        world = task.build_world()
        limit = np.inf if task.robot.tilt_limit is None else task.robot.tilt_limit
        return cls(
            (*world.walls, *world.obstacles),
            task.robot.radius,
            task.rewards.collision,
            limit,
            tilt_reward(task.rewards),
        )

    def rewards(self, names: tuple[str, ...], states: Array) -> Array:
        """Return the rewards (N,) at states (N, n) with components `names`; NaN outside the set."""
        out = np.full(len(states), np.nan)
        points = states[:, position_indices(names)]
        new = np.append(True, np.any(points[1:] != points[:-1], axis=1))[: len(points)]  # a grid repeats each point
        collides = signed_distance(self.shapes, points[new]) <= self.radius
        out[collides[np.cumsum(new) - 1]] = self.reward
        if "psi" in names:
            out[np.abs(wrap(states[:, names.index("psi")])) > self.tilt_limit] = self.tilt_reward
        return out

    def as_json(self) -> dict[str, Any]:
        """Return the set as plain JSON values."""
        shapes = [
            {"box": [*shape.centre, *shape.size, shape.angle]}
            if isinstance(shape, Box)
            else {"disc": [*shape.centre, shape.radius]}
            for shape in self.shapes
        ]
        limit = self.tilt_limit if np.isfinite(self.tilt_limit) else None
        return {"shapes": shapes, "radius": self.radius, "reward": self.reward, "tilt_limit": limit,
                "tilt_reward": self.tilt_reward}  # fmt: skip

    @classmethod
    def from_file(cls, told: CollisionHeader) -> CollisionSet:
        """Create the set from the JSON values of `as_json`."""
        limit = np.inf if told.tilt_limit is None else told.tilt_limit
        return cls(tuple(shape.shape for shape in told.shapes), told.radius, told.reward, limit, told.tilt_reward)

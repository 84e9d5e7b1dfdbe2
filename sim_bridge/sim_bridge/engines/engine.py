"""Common interface of the physics engines, in terms of a task.

A world in the x-y plane has a floor; one in the x-z plane floats in space (its floor is a wall of the task).
Robots are numbered from 0 in the order in which they are added.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Box, Shape

URDF_FOLDER = Path(__file__).parents[1] / "urdf"
GRAVITY = 9.81
WALL_HEIGHT = 0.5
"""Height of walls and obstacles in the x-y plane [m], above every lidar."""
SLAB_DEPTH = 2.0
"""Depth of walls and obstacles across the x-z plane [m]."""
MOVER_MASS = 1e5
"""Mass of a mover [kg], large enough that no robot slows it down."""
MOST_ROBOTS = 29
"""Maximum number of robots: in PyBullet each has its own bit, so that a lidar can ignore its own robot."""
SEARCH_LIMIT = 100.0
"""Distances beyond this count as infinite [m]."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WheeledRobot:
    """A robot on a floor, driven by two wheels.

    Attributes:
        urdf: Path of its file, or its name in `urdf/`; wheels turn about `wheel_left_joint` and `wheel_right_joint`.
        pose: Pose x, y, theta of the root link at the start (3,) [m, m, rad].
        torque: Maximum torque of one wheel [N m].
        friction: Friction coefficient between wheel and floor.
        steered: Whether it has front wheels, which turn about `front_left_joint` and `front_right_joint`, and are
            steered about `steer_left_joint` and `steer_right_joint`.
    """

    urdf: str
    pose: Array
    torque: float
    friction: float = 1.0
    steered: bool = False


@dataclass(frozen=True)
class FlyingRobot:
    """A robot constrained to the x-z plane by frictionless joints `x`, `z` and `psi`.

    Attributes:
        urdf: Path of its file, or its name in `urdf/`.
        pose: Joint positions x, z, psi at the start (3,) [m, m, rad].
        velocity: Joint speeds at the start (3,) [m/s, m/s, rad/s].
        mass: Mass of the whole robot [kg].
        inertia: Moment of inertia about y [kg m^2].
    """

    urdf: str
    pose: Array
    velocity: Array
    mass: float
    inertia: float


class WheelBase(Protocol):
    """A wheeled robot in an engine."""

    def turn_wheels(self, left: float, right: float) -> None:
        """Set the target speeds of the wheels' motors [rad/s]."""

    def steer(self, left: float, right: float) -> None:
        """Set the steering angles of the front wheels, to the left [rad]; only for a steered robot."""

    def wheel_angles(self) -> tuple[float, float]:
        """Return the angles of the left and right wheel [rad]."""

    def pose(self) -> Array:
        """Return x, y, theta (3,) [m, m, rad]."""

    def velocity(self) -> Array:
        """Return the rates of `pose` (3,) [m/s, m/s, rad/s]."""

    def quaternion(self) -> tuple[float, float, float, float]:
        """Return the attitude (x, y, z, w)."""


class PlanarJoints(Protocol):
    """A flying robot in an engine, integrated by semi-implicit Euler."""

    def push(self, force: Array) -> None:
        """Set force along x and z and moment about psi (3,) [N, N, N m] for the next step."""

    def pose(self) -> Array:
        """Return x, z, psi (3,) [m, m, rad]."""

    def velocity(self) -> Array:
        """Return the joint speeds (3,) [m/s, m/s, rad/s]."""


class MovingDisc(Protocol):
    """A disc that keeps moving through contacts."""

    def move(self, position: tuple[float, float], velocity: tuple[float, float]) -> None:
        """Place the disc at a position [m]; in the next step it moves at a velocity [m/s]."""


class PlacedDisc(Protocol):
    """A disc-shaped robot positioned by its own equations of motion."""

    def put(self, x: float, second: float, angle: float) -> None:
        """Place the disc at a position in the plane [m] and a counter-clockwise angle [rad]."""


class Engine(Protocol):
    """A physics engine with one world, advanced in whole steps.

    To build a world, call `begin`, one `add_...` per robot and mover, and `finish`; the next `begin` clears the world.

    Attributes:
        name: Name of the engine.
        rate: Physics steps per second [Hz].
    """

    name: str
    rate: int

    def begin(self, plane: str, shapes: Sequence[Shape]) -> None:
        """Start building a world of walls and obstacles in a plane, "xy" or "xz"."""

    def add_wheeled(self, robot: WheeledRobot) -> WheelBase:
        """Add a wheeled robot.

        Raises:
            SimulationError: There are too many robots.
        """

    def add_flying(self, robot: FlyingRobot) -> PlanarJoints:
        """Add a flying robot.

        Raises:
            SimulationError: There are too many robots.
        """

    def add_disc(self, radius: float) -> PlacedDisc:
        """Add a disc-shaped robot of a radius [m].

        Raises:
            SimulationError: There are too many robots, or the engine does not support disc-shaped robots.
        """

    def add_mover(self, radius: float, position: tuple[float, float]) -> MovingDisc:
        """Add a mover of a radius at a position [m]; robots and rays hit it, walls and other movers do not.

        The mover is a cylinder, `WALL_HEIGHT` high in the x-y plane, or `SLAB_DEPTH` deep across the x-z plane.
        """

    def finish(self) -> None:
        """Complete the world; afterwards steps, ray casts and distance queries are allowed."""

    def step(self) -> None:
        """Advance by one physics step of 1 / rate."""

    def cast(self, origin: Array, ends: Array, robot: int) -> Array:
        """Return the free fraction (n,) of each ray from `origin` (3,) to `ends` (n, 3).

        Args:
            origin: Start of the rays [m].
            ends: Ends of the rays, all at the same distance [m].
            robot: Index of the robot that the rays ignore.
        """

    def distance(self, robot: int, guess: float) -> float:
        """Return the distance from a robot to the nearest wall, obstacle, mover or robot [m].

        The distance is negative if they overlap, and inf if nothing is within `SEARCH_LIMIT`.

        Args:
            robot: Index of the robot.
            guess: Initial search radius [m]; fastest when slightly above the answer.
        """

    def mover_distance(self, robot: int, mover: int, limit: float) -> float:
        """Return the distance from a robot to a mover (indexed as added), at most `limit` [m]."""

    def close(self) -> None:
        """Release the engine; may be called twice."""


def placed(shape: Shape, plane: str) -> tuple[list[float], list[float], list[float]]:
    """Return half extents, position and quaternion (x, y, z, w) of a planar shape in 3D."""
    size = shape.size if isinstance(shape, Box) else (0.0, 0.0)
    angle = shape.angle if isinstance(shape, Box) else 0.0
    first, second = shape.centre
    s, c = math.sin(0.5 * angle), math.cos(0.5 * angle)
    if plane == "xy":
        return [0.5 * size[0], 0.5 * size[1], 0.5 * WALL_HEIGHT], [first, second, 0.5 * WALL_HEIGHT], [0.0, 0.0, s, c]
    extents, position = [0.5 * size[0], 0.5 * SLAB_DEPTH, 0.5 * size[1]], [first, 0.0, second]
    if isinstance(shape, Box):
        return extents, position, [0.0, -s, 0.0, c]  # counter-clockwise from x to z means about -y
    return extents, position, [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]  # a disc is a cylinder normal to the plane

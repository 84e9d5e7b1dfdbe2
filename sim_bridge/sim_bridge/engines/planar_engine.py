"""Planar worlds without contact forces, fast enough for learning.

Wheeled robots roll without slipping, with torque-limited motors; quadrotors follow their rigid-body equations.
Distances and lidar rays are exact. Contacts exert no force: a robot that touches something counts as collided, and
passes through.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ctrl_rl_core import Box, Disc, Shape
from sim_bridge.engines.engine import MOST_ROBOTS, SEARCH_LIMIT, WALL_HEIGHT, Array, FlyingRobot, WheeledRobot
from sim_bridge.engines.planar_geometry import COLUMNS, SEEN, cast, nearest, place
from sim_bridge.engines.planar_motion import RollingDrives
from sim_bridge.engines.planar_parts import Outline, disc_outline, outline
from sim_bridge.errors import SimulationError


class PlanarEngine:
    """An `Engine` of rigid bodies in a plane, without contact forces or friction.

    Attributes:
        rate: Physics steps per second [Hz].
    """

    name = "planar"

    def __init__(self, rate: int) -> None:
        self.rate = rate
        self._plane, self._fixed = "xy", tuple[Shape, ...]()
        self._shapes = np.zeros((0, COLUMNS))
        self._robots: list[_PlanarRobot] = []
        self._movers: list[PlanarMover] = []

    def begin(self, plane: str, shapes: Sequence[Shape]) -> None:  # noqa: D102 - see Engine
        fixed = tuple(shapes)
        if (plane, fixed) != (self._plane, self._fixed):
            self._plane, self._fixed = plane, fixed
            self._shapes = np.array([shape_row(shape) for shape in fixed]).reshape(-1, COLUMNS)
        self._robots, self._movers = [], []

    def add_wheeled(self, robot: WheeledRobot) -> PlanarWheels:  # noqa: D102
        wheels = PlanarWheels(robot, self.rate)
        self._add(wheels)
        return wheels

    def add_flying(self, robot: FlyingRobot) -> PlanarFlight:  # noqa: D102
        joints = PlanarFlight(robot, self.rate)
        self._add(joints)
        return joints

    def add_disc(self, radius: float) -> PlanarDisc:  # noqa: D102
        disc = PlanarDisc(radius)
        self._add(disc)
        return disc

    def add_mover(self, radius: float, position: tuple[float, float]) -> PlanarMover:  # noqa: D102
        self._movers.append(PlanarMover(radius, position, 1.0 / self.rate))
        return self._movers[-1]

    def _add(self, robot: _PlanarRobot) -> None:
        if len(self._robots) == MOST_ROBOTS:
            raise SimulationError(f"a world holds at most {MOST_ROBOTS} robots")
        self._robots.append(robot)

    def finish(self) -> None:  # noqa: D102
        movers = [shape_row(Disc(mover.position, mover.radius)) for mover in self._movers]
        standing = self._shapes[: len(self._fixed)]
        first = len(standing) + len(movers)
        outlines = [robot.outline(self._plane) for robot in self._robots]
        self._parts = np.concatenate([np.zeros((0, 7)), *(each.parts for each in outlines)])
        self._outer = [each.outer for each in outlines]
        ends = np.cumsum([first, *(len(each.parts) for each in outlines)])
        self._ranges = [(int(low), int(high)) for low, high in pairwise(ends)]
        moving = np.concatenate((np.array(movers).reshape(-1, COLUMNS), np.zeros((len(self._parts), COLUMNS))))
        self._shapes = np.concatenate((standing, moving))
        self._shapes[first:, 4:7] = self._parts[:, 2:5]
        self._placed = False

    def step(self) -> None:  # noqa: D102
        for robot in self._robots:
            robot.advance()
        for mover in self._movers:
            mover.advance()
        self._placed = False

    def _place(self) -> None:
        """Update the shapes of all robots and movers."""
        if self._placed:
            return
        for robot, (low, high) in zip(self._robots, self._ranges, strict=True):
            x, y, angle = robot.place()
            place(self._shapes, self._parts, low, high, x, y, angle)
        for index, mover in enumerate(self._movers, len(self._fixed)):
            self._shapes[index, :2] = mover.position
        self._placed = True

    def cast(self, origin: Array, ends: Array, robot: int) -> Array:  # noqa: D102
        self._place()
        first, second, across = (0, 1, 2) if self._plane == "xy" else (0, 2, 1)
        height = origin[across]
        robots = len(self._shapes) - len(self._parts)
        self._shapes[:robots, SEEN] = self._plane == "xz" or height <= WALL_HEIGHT
        self._shapes[robots:, SEEN] = (self._parts[:, 5] <= height) & (height <= self._parts[:, 6])
        self._shapes[slice(*self._ranges[robot]), SEEN] = 0.0
        free = np.empty(len(ends))
        cast(self._shapes, origin[first], origin[second], (ends - origin)[:, [first, second]], free)
        return free

    def distance(self, robot: int, guess: float) -> float:  # noqa: ARG002, D102 - nothing is searched
        self._place()
        found: float = nearest(self._shapes, *self._ranges[robot], self._outer[robot], SEARCH_LIMIT)
        return found if found < SEARCH_LIMIT else math.inf

    def mover_distance(self, robot: int, mover: int, limit: float) -> float:  # noqa: D102
        self._place()
        first, last = self._ranges[robot]
        rows = np.concatenate((self._shapes[[len(self._fixed) + mover]], self._shapes[first:last]))
        found: float = nearest(rows, 1, len(rows), self._outer[robot], limit)
        return found

    def close(self) -> None:
        """Do nothing; there are no resources to release."""


class _PlanarRobot:
    """A robot of the planar engine."""

    def outline(self, plane: str) -> Outline:
        """Return its collision shapes in the plane "xy" or "xz"."""
        raise NotImplementedError

    def advance(self) -> None:
        """Move by one physics step."""
        raise NotImplementedError

    def place(self) -> tuple[float, float, float]:
        """Return position and counter-clockwise angle in the plane [m, m, rad]."""
        raise NotImplementedError


class PlanarWheels(_PlanarRobot):
    """A `WheelBase` that rolls without slipping."""

    def __init__(self, robot: WheeledRobot, rate: int) -> None:
        self._urdf, self._drives = robot.urdf, RollingDrives(robot.urdf, robot.torque, 1, rate)
        self._drives.begin(0, robot.pose)

    def outline(self, plane: str) -> Outline:  # noqa: D102 - see _PlanarRobot
        return outline(self._urdf, plane)

    def turn_wheels(self, left: float, right: float) -> None:  # noqa: D102 - see WheelBase
        self._drives.wanted[0] = left, right

    def steer(self, left: float, right: float) -> None:
        """Do nothing; the rear wheels alone, which never slip, say where the robot goes."""

    def advance(self) -> None:  # noqa: D102 - see _PlanarRobot
        self._drives.advance()

    def place(self) -> tuple[float, float, float]:  # noqa: D102
        x, y, theta = self._drives.poses[0].tolist()
        return x, y, theta

    def wheel_angles(self) -> tuple[float, float]:  # noqa: D102
        left, right = self._drives.angles[0].tolist()
        return left, right

    def pose(self) -> Array:  # noqa: D102
        x, y, theta = self.place()
        return np.array((x, y, math.remainder(theta, 2.0 * math.pi)))

    def velocity(self) -> Array:  # noqa: D102
        v, omega = self._drives.twist(0)
        theta = self.place()[2]
        return np.array((v * math.cos(theta), v * math.sin(theta), omega))

    def quaternion(self) -> tuple[float, float, float, float]:  # noqa: D102
        half = 0.5 * self.place()[2]
        return 0.0, 0.0, math.sin(half), math.cos(half)


class PlanarFlight(_PlanarRobot):
    """`PlanarJoints` of a free body."""

    def __init__(self, robot: FlyingRobot, rate: int) -> None:
        self._urdf = robot.urdf
        self._pose, self._velocity = robot.pose.copy(), robot.velocity.copy()
        self._per_force = 1.0 / (rate * np.array((robot.mass, robot.mass, robot.inertia)))
        self._step = 1.0 / rate

    def outline(self, plane: str) -> Outline:  # noqa: D102 - see _PlanarRobot
        return outline(self._urdf, plane)

    def push(self, force: Array) -> None:  # noqa: D102 - see PlanarJoints
        self._velocity += force * self._per_force

    def advance(self) -> None:  # noqa: D102 - see _PlanarRobot
        self._pose += self._velocity * self._step

    def place(self) -> tuple[float, float, float]:  # noqa: D102
        x, z, psi = self._pose.tolist()
        return x, z, -psi  # psi is clockwise in the x-z plane

    def pose(self) -> Array:  # noqa: D102
        return self._pose.copy()

    def velocity(self) -> Array:  # noqa: D102
        return self._velocity.copy()


class PlanarDisc(_PlanarRobot):
    """A `PlacedDisc` in the planar engine."""

    def __init__(self, radius: float) -> None:
        self._radius, self._place = radius, (0.0, 0.0, 0.0)

    def outline(self, plane: str) -> Outline:  # noqa: ARG002, D102 - see _PlanarRobot
        return disc_outline(self._radius)

    def put(self, x: float, second: float, angle: float) -> None:  # noqa: D102 - see PlacedDisc
        self._place = (x, second, angle)

    def advance(self) -> None:
        """Do nothing; the disc is positioned by its own equations."""

    def place(self) -> tuple[float, float, float]:  # noqa: D102
        return self._place


class PlanarMover:
    """A `MovingDisc` in the planar engine.

    Attributes:
        radius: Radius of the disc [m].
        position: Position of its centre [m].
    """

    def __init__(self, radius: float, position: tuple[float, float], step: float) -> None:
        self.radius, self.position, self._step = radius, position, step
        self._velocity = (0.0, 0.0)

    def move(self, position: tuple[float, float], velocity: tuple[float, float]) -> None:  # noqa: D102 - see MovingDisc
        self.position, self._velocity = position, velocity

    def advance(self) -> None:
        """Move by one physics step."""
        (x, y), (v_x, v_y) = self.position, self._velocity
        self.position = (x + v_x * self._step, y + v_y * self._step)


def shape_row(shape: Shape) -> tuple[float, ...]:
    """Convert a wall or obstacle to a row (8,) of `planar_geometry`."""
    if isinstance(shape, Box):
        extent, radius, angle = (0.5 * shape.size[0], 0.5 * shape.size[1]), 0.0, shape.angle
    else:
        extent, radius, angle = (0.0, 0.0), shape.radius, 0.0
    return (*shape.centre, math.cos(angle), math.sin(angle), *extent, radius, 1.0)

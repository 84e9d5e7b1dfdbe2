"""Worlds in PyBullet; the only module that owns a client."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ctrl_rl_core import Box, Disc, Shape
from sim_bridge.engines.engine import (
    GRAVITY,
    MOST_ROBOTS,
    SEARCH_LIMIT,
    SLAB_DEPTH,
    URDF_FOLDER,
    WALL_HEIGHT,
    Array,
    FlyingRobot,
    PlacedDisc,
    WheeledRobot,
    placed,
)
from sim_bridge.engines.pybullet_bodies import ALL_GROUPS, PybulletJoints, PybulletMover, PybulletWheels
from sim_bridge.engines.quiet_pybullet import pybullet
from sim_bridge.errors import SimulationError

_SHAPES_PER_BODY = 16  # a limit of PyBullet; merged shapes speed up stepping, ray casts and resets
_FEW = 16  # number of fixed bodies below which all are searched, which is cheaper than a selection
_SOLVER_ITERATIONS = 30  # speeds of a drive are within 0.3 %; PyBullet's default of 50 costs half as much again


def _check_display() -> None:
    """Raise SimulationError without a display; PyBullet would end the process with an X error."""
    display = os.environ.get("DISPLAY", "")
    local = re.fullmatch(r":(\d+)(\.\d+)?", display)
    if not display:
        raise SimulationError("there is no display for a window (DISPLAY is not set): run with gui false")
    if local and not Path(f"/tmp/.X11-unix/X{local[1]}").exists():
        raise SimulationError(f"there is no display {display} for a window: run with gui false")


class PybulletEngine:
    """PyBullet implementation of `Engine`.

    Attributes:
        client: PyBullet id of the client.
        rate: Physics steps per second [Hz].
        fixed: PyBullet bodies of walls and obstacles.
        robots: PyBullet bodies of the robots.
        movers: PyBullet bodies of the movers.
    """

    name = "pybullet"

    def __init__(self, rate: int, gui: bool = False) -> None:
        self.rate = rate
        if gui:
            _check_display()
        self.client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)
        if self.client < 0:
            raise SimulationError("PyBullet did not start: without a display run with gui false")
        self.fixed: list[int] = []
        self.robots: list[int] = []
        self.movers: list[int] = []
        self._boxes: list[Array] = []

    def begin(self, plane: str, shapes: Sequence[Shape]) -> None:  # noqa: D102 - see Engine
        pybullet.resetSimulation(physicsClientId=self.client)  # including contact caches
        pybullet.setGravity(0.0, 0.0, -GRAVITY if plane == "xy" else 0.0, physicsClientId=self.client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=1.0 / self.rate,
            numSolverIterations=_SOLVER_ITERATIONS,
            deterministicOverlappingPairs=1,
            physicsClientId=self.client,
        )
        self.fixed.clear()
        self._boxes.clear()
        self.robots.clear()
        self.movers.clear()
        self._plane = plane
        if plane == "xy":
            self._add_floor()
        self.add_fixed(shapes, plane)

    def _add_floor(self) -> None:
        shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self.client)
        floor = pybullet.createMultiBody(0, shape, physicsClientId=self.client)
        pybullet.changeDynamics(floor, -1, lateralFriction=1.0, physicsClientId=self.client)

    def add_fixed(self, shapes: Sequence[Shape], plane: str) -> None:
        """Add walls and obstacles of a plane, "xy" or "xz"."""
        for begin in range(0, len(shapes), _SHAPES_PER_BODY):
            parts = shapes[begin : begin + _SHAPES_PER_BODY]
            places = [placed(part, plane) for part in parts]
            shape = pybullet.createCollisionShapeArray(
                shapeTypes=[pybullet.GEOM_BOX if isinstance(part, Box) else pybullet.GEOM_CYLINDER for part in parts],
                halfExtents=[extent for extent, _, _ in places],
                radii=[0.0 if isinstance(part, Box) else part.radius for part in parts],
                lengths=[WALL_HEIGHT if plane == "xy" else SLAB_DEPTH] * len(parts),
                collisionFramePositions=[position for _, position, _ in places],
                collisionFrameOrientations=[orientation for _, _, orientation in places],
                physicsClientId=self.client,
            )
            self.fixed.append(pybullet.createMultiBody(0, shape, physicsClientId=self.client))
            self._boxes.append(self._box(self.fixed[-1]))

    def add_wheeled(self, robot: WheeledRobot) -> PybulletWheels:  # noqa: D102
        x, y, theta = robot.pose
        body = self._load(robot.urdf, (x, y, 0.0), (0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta)))
        return PybulletWheels(self.client, body, self._joints(body), robot)

    def add_flying(self, robot: FlyingRobot) -> PybulletJoints:  # noqa: D102
        body = self._load(robot.urdf, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), rooted=True)
        return PybulletJoints(self.client, body, self._joints(body), robot)

    def add_disc(self, radius: float) -> PlacedDisc:  # noqa: ARG002, D102
        raise SimulationError(
            f"engine '{self.name}' does not simulate bodies with their own equations: use engine planar"
        )

    def add_mover(self, radius: float, position: tuple[float, float]) -> PybulletMover:  # noqa: D102
        mover = PybulletMover(self.client, self.rate, self._plane, Disc(position, radius))
        self.movers.append(mover.body)
        return mover

    def _load(self, urdf: str, position: Sequence[float], attitude: Sequence[float], rooted: bool = False) -> int:
        """Load a robot without damping, in a group that rays can ignore."""
        if len(self.robots) == MOST_ROBOTS:
            raise SimulationError(f"a world holds at most {MOST_ROBOTS} robots")
        body: int = pybullet.loadURDF(
            str(URDF_FOLDER / urdf),
            position,
            attitude,
            useFixedBase=rooted,
            flags=pybullet.URDF_USE_IMPLICIT_CYLINDER | pybullet.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=self.client,
        )
        own = _own_bit(len(self.robots))
        for link in range(-1, pybullet.getNumJoints(body, physicsClientId=self.client)):
            pybullet.changeDynamics(
                body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=self.client
            )
            pybullet.setCollisionFilterGroupMask(body, link, own, ALL_GROUPS, physicsClientId=self.client)
        self.robots.append(body)
        return body

    def _joints(self, body: int) -> dict[str, int]:
        """Return the joints of a body by name."""
        count = pybullet.getNumJoints(body, physicsClientId=self.client)
        names = (pybullet.getJointInfo(body, joint, physicsClientId=self.client)[1] for joint in range(count))
        return {name.decode(): joint for joint, name in enumerate(names)}

    def finish(self) -> None:
        """Do nothing; everything has already been added."""

    def step(self) -> None:  # noqa: D102
        pybullet.stepSimulation(physicsClientId=self.client)

    def cast(self, origin: Array, ends: Array, robot: int) -> Array:  # noqa: D102
        hits = pybullet.rayTestBatch(
            np.broadcast_to(origin, ends.shape).copy(),
            ends,
            collisionFilterMask=ALL_GROUPS & ~_own_bit(robot),
            physicsClientId=self.client,
        )
        return np.array([hit[2] for hit in hits])

    def distance(self, robot: int, guess: float) -> float:  # noqa: D102
        body = self.robots[robot]
        others = [other for other in self.robots if other != body]
        gaps = self._gaps(robot)
        reach = max(guess, 0.05)
        while reach < SEARCH_LIMIT:
            nearest = math.inf
            near = self.fixed if gaps is None else [self.fixed[index] for index in np.flatnonzero(gaps < reach)]
            for other in (*near, *others, *self.movers):
                for point in pybullet.getClosestPoints(body, other, reach, physicsClientId=self.client):
                    nearest = min(nearest, point[8])
            if nearest < math.inf:
                return nearest
            reach *= 3.0
        return math.inf

    def mover_distance(self, robot: int, mover: int, limit: float) -> float:  # noqa: D102
        body, other = self.robots[robot], self.movers[mover]
        points = pybullet.getClosestPoints(body, other, limit, physicsClientId=self.client)
        return min((point[8] for point in points), default=limit)

    def _gaps(self, robot: int) -> Array | None:
        """Return lower bounds of a robot's distances to the bodies of `fixed` (n,) [m]; None if there are few."""
        if len(self.fixed) <= _FEW:
            return None
        (least, largest), boxes = self._box(self.robots[robot]), np.array(self._boxes)
        return np.linalg.norm(np.maximum(np.maximum(boxes[:, 0] - largest, least - boxes[:, 1]), 0.0), axis=1)

    def _box(self, body: int) -> Array:
        """Return the axis-aligned box around all links of a body: minimum and maximum corner (2, 3) [m]."""
        links = range(-1, pybullet.getNumJoints(body, physicsClientId=self.client))
        boxes = np.array([pybullet.getAABB(body, link, physicsClientId=self.client) for link in links])
        return np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)))

    def close(self) -> None:  # noqa: D102
        if self.client >= 0:
            pybullet.disconnect(physicsClientId=self.client)
            self.client = -1


def _own_bit(robot: int) -> int:
    return 1 << (robot + 2)

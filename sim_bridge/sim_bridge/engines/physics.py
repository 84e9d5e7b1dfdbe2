"""The one place that owns a PyBullet client: engine settings, fixed shapes, ray casts, distances.

A world in the x-y plane stands on a floor; one in the x-z plane hangs in space (its floor is a wall of the task).
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Box, Shape
from sim_bridge.engines.quiet_pybullet import pybullet
from sim_bridge.errors import SimulationError

URDF_FOLDER = Path(__file__).parents[1] / "urdf"
WALL_HEIGHT = 0.5
"""Of walls and obstacles in the x-y plane [m]: higher than every lidar."""
SLAB_DEPTH = 2.0
"""Of walls and obstacles across the x-z plane [m]."""
MOST_ROBOTS = 29
"""Each body has a bit of its own, so that a lidar can overlook the robot that carries it."""

Array = NDArray[np.float64]
_SHAPES_PER_BODY = 16  # a limit of PyBullet; merged shapes make stepping, ray casts and resets cheaper
_SOLVER_ITERATIONS = 30  # speeds of a drive within 0.3 %; PyBullet's 50 cost half as much again
_ALL_GROUPS = 0x7FFFFFFF
_SEARCH_LIMIT = 100.0


def _check_display() -> None:
    """Raise SimulationError where there is no display: PyBullet would end the process with an error of X."""
    display = os.environ.get("DISPLAY", "")
    local = re.fullmatch(r":(\d+)(\.\d+)?", display)
    if not display:
        raise SimulationError("there is no display for a window (DISPLAY is not set): run with gui false")
    if local and not Path(f"/tmp/.X11-unix/X{local[1]}").exists():
        raise SimulationError(f"there is no display {display} for a window: run with gui false")


class Physics:
    """A PyBullet client that runs in whole steps.

    Attributes:
        client: PyBullet's number of it.
        rate: Physics steps per second [Hz].
        fixed: PyBullet bodies of walls and obstacles.
    """

    def __init__(self, rate: int, gui: bool = False) -> None:
        self.rate = rate
        if gui:
            _check_display()
        self.client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)
        if self.client < 0:
            raise SimulationError("PyBullet gives no physics client: without a display run with gui false")
        self.fixed: list[int] = []
        self._robots = 0

    def clear(self, gravity: float) -> None:
        """Empty the world, contact caches included, and set the engine up.

        Args:
            gravity: Gravity, positive downwards [m/s^2].
        """
        pybullet.resetSimulation(physicsClientId=self.client)
        pybullet.setGravity(0.0, 0.0, -gravity, physicsClientId=self.client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=1.0 / self.rate,
            numSolverIterations=_SOLVER_ITERATIONS,
            deterministicOverlappingPairs=1,
            physicsClientId=self.client,
        )
        self.fixed.clear()
        self._robots = 0

    def add_floor(self) -> None:
        """Add the plane z = 0 with the grip of wheels on a floor."""
        shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self.client)
        floor = pybullet.createMultiBody(0, shape, physicsClientId=self.client)
        pybullet.changeDynamics(floor, -1, lateralFriction=1.0, physicsClientId=self.client)

    def add_fixed(self, shapes: Sequence[Shape], plane: str) -> None:
        """Add walls and obstacles of a plane, "xy" or "xz"."""
        for begin in range(0, len(shapes), _SHAPES_PER_BODY):
            parts = shapes[begin : begin + _SHAPES_PER_BODY]
            placed = [_placed(part, plane) for part in parts]
            shape = pybullet.createCollisionShapeArray(
                shapeTypes=[pybullet.GEOM_BOX if isinstance(part, Box) else pybullet.GEOM_CYLINDER for part in parts],
                halfExtents=[extent for extent, _, _ in placed],
                radii=[0.0 if isinstance(part, Box) else part.radius for part in parts],
                lengths=[WALL_HEIGHT if plane == "xy" else SLAB_DEPTH] * len(parts),
                collisionFramePositions=[position for _, position, _ in placed],
                collisionFrameOrientations=[orientation for _, _, orientation in placed],
                physicsClientId=self.client,
            )
            self.fixed.append(pybullet.createMultiBody(0, shape, physicsClientId=self.client))

    def load(self, urdf: str, position: Sequence[float], yaw: float = 0.0, rooted: bool = False) -> tuple[int, int]:
        """Load a robot without any damping and return its PyBullet body and the ray mask that overlooks it.

        Args:
            urdf: File name in `urdf/`.
            position: Position of the root link (3,) [m].
            yaw: About z [rad].
            rooted: Whether the root link is fixed in space.

        Raises:
            SimulationError: Too many robots.
        """
        if self._robots == MOST_ROBOTS:
            raise SimulationError(f"a world holds at most {MOST_ROBOTS} robots")
        self._robots += 1
        body = pybullet.loadURDF(
            str(URDF_FOLDER / urdf),
            position,
            (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)),
            useFixedBase=rooted,
            flags=pybullet.URDF_USE_IMPLICIT_CYLINDER | pybullet.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=self.client,
        )
        own = 1 << (self._robots + 1)
        for link in range(-1, pybullet.getNumJoints(body, physicsClientId=self.client)):
            pybullet.changeDynamics(
                body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=self.client
            )
            pybullet.setCollisionFilterGroupMask(body, link, own, _ALL_GROUPS, physicsClientId=self.client)
        return body, _ALL_GROUPS & ~own

    def joints(self, body: int) -> dict[str, int]:
        """Return the joints of a body by name."""
        count = pybullet.getNumJoints(body, physicsClientId=self.client)
        names = (pybullet.getJointInfo(body, joint, physicsClientId=self.client)[1] for joint in range(count))
        return {name.decode(): joint for joint, name in enumerate(names)}

    def step(self) -> None:
        """Advance by 1 / rate."""
        pybullet.stepSimulation(physicsClientId=self.client)

    def cast(self, origin: Array, ends: Array, mask: int) -> Array:
        """Return the part of each ray from `origin` (3,) to `ends` (n, 3) that is free (n,); 1 where all of it is."""
        hits = pybullet.rayTestBatch(
            np.broadcast_to(origin, ends.shape).copy(), ends, collisionFilterMask=mask, physicsClientId=self.client
        )
        return np.array([hit[2] for hit in hits])

    def distance(self, body: int, others: Sequence[int], guess: float) -> float:
        """Return the distance of a body to the nearest of `others` [m], negative where they overlap; inf for none.

        Args:
            body: PyBullet's number of the body.
            others: PyBullet's numbers of the other bodies.
            guess: Where to begin the search [m]; costs least when a little more than the answer.
        """
        reach = max(guess, 0.05)
        while reach < _SEARCH_LIMIT:
            nearest = math.inf
            for other in others:
                for point in pybullet.getClosestPoints(body, other, reach, physicsClientId=self.client):
                    nearest = min(nearest, point[8])
            if nearest < math.inf:
                return nearest
            reach *= 3.0
        return math.inf

    def close(self) -> None:
        """Give the client back; a second call does nothing."""
        if self.client >= 0:
            pybullet.disconnect(physicsClientId=self.client)
            self.client = -1


def _placed(shape: Shape, plane: str) -> tuple[list[float], list[float], list[float]]:
    """Return half extents, position and quaternion (x, y, z, w) of a plane shape in space."""
    size = shape.size if isinstance(shape, Box) else (0.0, 0.0)
    angle = shape.angle if isinstance(shape, Box) else 0.0
    first, second = shape.centre
    s, c = math.sin(0.5 * angle), math.cos(0.5 * angle)
    if plane == "xy":
        return [0.5 * size[0], 0.5 * size[1], 0.5 * WALL_HEIGHT], [first, second, 0.5 * WALL_HEIGHT], [0.0, 0.0, s, c]
    extents, position = [0.5 * size[0], 0.5 * SLAB_DEPTH, 0.5 * size[1]], [first, 0.0, second]
    if isinstance(shape, Box):
        return extents, position, [0.0, -s, 0.0, c]  # counter-clockwise from x to z is about -y
    return extents, position, [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]  # a disc is a cylinder across the plane

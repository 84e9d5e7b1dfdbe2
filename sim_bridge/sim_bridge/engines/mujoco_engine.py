"""Worlds in MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Box, Shape
from sim_bridge.engines.engine import MOST_ROBOTS, SEARCH_LIMIT, Array, FlyingRobot, PlacedDisc, WheeledRobot
from sim_bridge.engines.mujoco_model import (
    MOTOR,
    PLANAR_JOINTS,
    ROOT,
    STEERING,
    WHEELS,
    build_model,
    fixed_geom,
    mover_name,
    prefix,
    wheel_joints,
)
from sim_bridge.errors import SimulationError

_FAR = 1
_SEEN = np.array((1, 0, 0, 0, 0, 0), np.uint8)
"""Geom groups for rays. Geoms out of reach, since each ray checks every geom, and the lidar's own robot get another."""


class MujocoEngine:
    """MuJoCo implementation of `Engine`; the model is reused while walls, obstacles and robots are the same.

    Attributes:
        rate: Physics steps per second [Hz].
    """

    name = "mujoco"

    def __init__(self, rate: int) -> None:
        self.rate = rate
        self._built: tuple[object, ...] = ()
        self._plane, self._shapes = "xy", tuple[Shape, ...]()
        self._robots: list[_MujocoRobot] = []
        self._movers: list[MujocoMover] = []

    def begin(self, plane: str, shapes: Sequence[Shape]) -> None:  # noqa: D102 - see Engine
        self._plane, self._shapes = plane, tuple(shapes)
        self._robots, self._movers = [], []

    def add_wheeled(self, robot: WheeledRobot) -> MujocoWheels:  # noqa: D102
        wheels = MujocoWheels(robot)
        self._add(wheels)
        return wheels

    def add_flying(self, robot: FlyingRobot) -> MujocoJoints:  # noqa: D102
        joints = MujocoJoints(robot)
        self._add(joints)
        return joints

    def add_disc(self, radius: float) -> PlacedDisc:  # noqa: ARG002, D102
        raise SimulationError(
            f"engine '{self.name}' does not simulate bodies with their own equations: use engine planar"
        )

    def add_mover(self, radius: float, position: tuple[float, float]) -> MujocoMover:  # noqa: D102
        self._movers.append(MujocoMover(radius, position))
        return self._movers[-1]

    def _add(self, robot: _MujocoRobot) -> None:
        if len(self._robots) == MOST_ROBOTS:
            raise SimulationError(f"a world holds at most {MOST_ROBOTS} robots")
        self._robots.append(robot)

    def finish(self) -> None:  # noqa: D102
        radii = tuple(mover.radius for mover in self._movers)
        wanted = (self._plane, self._shapes, tuple(robot.kind for robot in self._robots), radii)
        if wanted != self._built:
            robots = [robot.robot for robot in self._robots]
            self._model = build_model(self.rate, self._plane, self._shapes, robots, radii)
            self._data = mujoco.MjData(self._model)
            self._fixed = np.array([_bounds(shape) for shape in self._shapes]).reshape(-1, 4)
            self._built = wanted
        mujoco.mj_resetData(self._model, self._data)
        for number, robot in enumerate(self._robots):
            robot.place(self._model, self._data, number)
        for number, mover in enumerate(self._movers):
            mover.place(self._model, self._data, number)
        self._moved()

    def _moved(self) -> None:
        self._placed = False

    def _place_geoms(self) -> None:
        """Update the poses of all geoms."""
        if not self._placed:
            mujoco.mj_kinematics(self._model, self._data)
            self._placed = True

    def step(self) -> None:  # noqa: D102
        mujoco.mj_step(self._model, self._data)
        self._moved()

    def cast(self, origin: Array, ends: Array, robot: int) -> Array:  # noqa: D102
        self._place_geoms()
        rays = ends - origin
        reach = float(np.sqrt(rays[0] @ rays[0]))
        in_reach = self._gaps(origin) <= reach
        first = fixed_geom(self._plane, 0)
        self._model.geom_group[first : first + len(in_reach)] = np.where(in_reach, 0, _FAR)
        for number, other in enumerate(self._robots):  # a robot's wheels are bodies of their own
            self._model.geom_group[other.geoms] = _FAR if number == robot else 0
        count = len(rays)
        hit, distance = np.empty(count, dtype=np.int32), np.empty(count)
        mujoco.mj_multiRay(
            self._model,
            self._data,
            origin,
            (rays / reach).ravel(),
            _SEEN,
            True,
            -1,
            hit,
            distance,
            None,
            count,
            reach,
        )
        return np.where((hit < 0) | (distance > reach), 1.0, distance / reach)

    def distance(self, robot: int, guess: float) -> float:  # noqa: ARG002, D102 - the nearest are searched first
        self._place_geoms()
        own = self._robots[robot]
        nearest = SEARCH_LIMIT
        least = self._gaps(self._data.xpos[own.body]) - own.radius
        for index in np.argsort(least, kind="stable").tolist():
            if least[index] >= nearest:
                break
            nearest = min(nearest, self._between(own.geoms, [fixed_geom(self._plane, index)], nearest))
        for other in self._robots:
            if other is not own:
                nearest = min(nearest, self._between(own.geoms, other.geoms, nearest))
        for mover in self._movers:
            nearest = min(nearest, self._between(own.geoms, [mover.geom], nearest))
        return nearest if nearest < SEARCH_LIMIT else math.inf

    def mover_distance(self, robot: int, mover: int, limit: float) -> float:  # noqa: D102
        self._place_geoms()
        return self._between(self._robots[robot].geoms, [self._movers[mover].geom], limit)

    def _gaps(self, point: Array) -> Array:
        """Return the distances of a point (3,) to the bounding box of each wall and obstacle (n,) [m]."""
        place = point[[0, 1] if self._plane == "xy" else [0, 2]]
        beside = np.maximum(np.maximum(self._fixed[:, :2] - place, place - self._fixed[:, 2:]), 0.0)
        return np.hypot(*beside.T)

    def _between(self, geoms: Sequence[int], others: Sequence[int], limit: float) -> float:
        """Return the minimum distance between geoms of two bodies [m], or the limit."""
        for geom in geoms:
            for other in others:
                limit = min(limit, mujoco.mj_geomDistance(self._model, self._data, geom, other, limit, None))
        return limit

    def close(self) -> None:  # noqa: D102
        self._built = ()
        self._model = self._data = None


class _MujocoRobot:
    """Common base of wheeled and flying robots.

    Attributes:
        robot: The requested robot.
        kind: Fields of the robot that determine its model.
        body: MuJoCo id of the body with the lidar.
        geoms: Geoms of the whole robot.
        radius: Radius of a sphere around the body's origin that encloses the robot [m].
    """

    def __init__(self, robot: WheeledRobot | FlyingRobot, kind: tuple[object, ...], body: str) -> None:
        self.robot, self.kind, self._body_name = robot, kind, body

    def place(self, model: mujoco.MjModel, data: mujoco.MjData, number: int) -> None:
        """Reset to the start of an episode."""
        self._data, own = data, prefix(number)
        self.body = model.body(own + self._body_name).id
        bodies = {body for body in range(model.nbody) if model.body(body).name.startswith(own)}
        self.geoms = [geom for geom in range(model.ngeom) if int(model.geom_bodyid[geom]) in bodies]
        self._start(model, own)
        mujoco.mj_kinematics(model, data)
        away = data.geom_xpos[self.geoms] - data.xpos[self.body]
        self.radius = float((np.sqrt((away**2).sum(axis=1)) + model.geom_rbound[self.geoms]).max())

    def _start(self, model: mujoco.MjModel, own: str) -> None:
        raise NotImplementedError


class MujocoWheels(_MujocoRobot):
    """A `WheelBase` in MuJoCo."""

    def __init__(self, robot: WheeledRobot) -> None:
        super().__init__(robot, (robot.urdf, robot.torque, robot.steered), ROOT)
        self._pose, self._friction, self._robot = robot.pose, robot.friction, robot

    def _start(self, model: mujoco.MjModel, own: str) -> None:
        joint = model.joint(own + ROOT)
        place, rate = int(joint.qposadr[0]), int(joint.dofadr[0])
        self._place, self._rate = slice(place, place + 7), slice(rate, rate + 6)
        self._wheels = [int(model.joint(own + name).qposadr[0]) for name in WHEELS]
        self._motors = [int(model.joint(own + name + MOTOR).dofadr[0]) for name in WHEELS]
        steering = [model.joint(own + name) for name in STEERING] if self._robot.steered else []
        self._steered = [int(joint.qposadr[0]) for joint in steering]
        self._steering = [int(joint.dofadr[0]) for joint in steering]
        self._rate_of_steps = 1.0 / float(model.opt.timestep)
        wheels = {int(model.joint(own + name).bodyid[0]) for name in wheel_joints(self._robot)}
        for geom in self.geoms:
            if int(model.geom_bodyid[geom]) in wheels:
                model.geom_friction[geom, 0] = self._friction
        x, y, theta = self._pose
        self._data.qpos[self._place] = (x, y, 0.0, math.cos(0.5 * theta), 0.0, 0.0, math.sin(0.5 * theta))

    def turn_wheels(self, left: float, right: float) -> None:  # noqa: D102 - see WheelBase
        self._data.qvel[self._motors] = (left, right)

    def steer(self, left: float, right: float) -> None:  # noqa: D102
        # As a motor's shaft, the joint is too heavy to be slowed down: within the next step it is where it should be.
        self._data.qvel[self._steering] = ((left, right) - self._data.qpos[self._steered]) * self._rate_of_steps

    def wheel_angles(self) -> tuple[float, float]:  # noqa: D102
        left, right = self._data.qpos[self._wheels]
        return float(left), float(right)

    def pose(self) -> Array:  # noqa: D102
        x, y, _, w, i, j, k = self._data.qpos[self._place].tolist()
        return np.array((x, y, math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))))

    def velocity(self) -> Array:  # noqa: D102
        v_x, v_y, _, _, _, omega = self._data.qvel[self._rate].tolist()
        return np.array((v_x, v_y, omega))  # omega is about the body's own axis, which is vertical within a thousandth

    def quaternion(self) -> tuple[float, float, float, float]:  # noqa: D102
        _, _, _, w, i, j, k = self._data.qpos[self._place].tolist()
        return i, j, k, w


class MujocoJoints(_MujocoRobot):
    """`PlanarJoints` in MuJoCo."""

    def __init__(self, robot: FlyingRobot) -> None:
        super().__init__(robot, (robot.urdf, robot.mass, robot.inertia), "base_link")
        self._pose, self._velocity = robot.pose, robot.velocity

    def _start(self, model: mujoco.MjModel, own: str) -> None:
        joints = [model.joint(own + name) for name in PLANAR_JOINTS]
        self._places = [int(joint.qposadr[0]) for joint in joints]
        self._rates = [int(joint.dofadr[0]) for joint in joints]
        self._data.qpos[self._places], self._data.qvel[self._rates] = self._pose, self._velocity

    def push(self, force: Array) -> None:  # noqa: D102 - see PlanarJoints
        self._data.qfrc_applied[self._rates] = force

    def pose(self) -> Array:  # noqa: D102
        return np.array(self._data.qpos[self._places])

    def velocity(self) -> Array:  # noqa: D102
        return np.array(self._data.qvel[self._rates])


class MujocoMover:
    """A `MovingDisc` in MuJoCo: a heavy body on two slide joints, because contacts ignore the speed of a `mocap` body.

    Attributes:
        radius: Radius of the disc [m].
        geom: MuJoCo id of its geom.
    """

    def __init__(self, radius: float, position: tuple[float, float]) -> None:
        self.radius, self._position = radius, position

    def place(self, model: mujoco.MjModel, data: mujoco.MjData, number: int) -> None:
        """Reset to the start of an episode."""
        self._data = data
        self.geom = int(model.geom(mover_name(number)).id)
        joints = [model.joint(mover_name(number, axis)) for axis in range(2)]
        self._places = [int(joint.qposadr[0]) for joint in joints]
        self._rates = [int(joint.dofadr[0]) for joint in joints]
        self.move(self._position, (0.0, 0.0))

    def move(self, position: tuple[float, float], velocity: tuple[float, float]) -> None:  # noqa: D102
        self._data.qpos[self._places], self._data.qvel[self._rates] = position, velocity


def _bounds(shape: Shape) -> NDArray[np.float64]:
    """Return the minimum and maximum coordinates of a shape in its plane (4,) [m]."""
    if isinstance(shape, Box):
        c, s = abs(math.cos(shape.angle)), abs(math.sin(shape.angle))
        half = 0.5 * np.array((c * shape.size[0] + s * shape.size[1], s * shape.size[0] + c * shape.size[1]))
    else:
        half = np.full(2, shape.radius)
    return np.concatenate((shape.centre - half, shape.centre + half))

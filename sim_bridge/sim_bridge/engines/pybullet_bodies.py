"""Bodies in a PyBullet client: wheeled robots, jointed robots, and movers."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ctrl_rl_core import Disc
from sim_bridge.engines.engine import (
    GRAVITY,
    MOVER_MASS,
    SLAB_DEPTH,
    WALL_HEIGHT,
    Array,
    FlyingRobot,
    WheeledRobot,
    placed,
)
from sim_bridge.engines.quiet_pybullet import pybullet

ALL_GROUPS = 0x7FFFFFFF
"""Contact and ray mask that matches every body."""
_STEERING_TORQUE = 1e4  # [N m]; the body moves the target as slowly as the steering is
_STATIC_GROUP = 2  # applies to all massless bodies


class PybulletWheels:
    """A `WheelBase` in PyBullet."""

    def __init__(self, client: int, body: int, joints: Mapping[str, int], robot: WheeledRobot) -> None:
        self._client, self._body, self._torque = client, body, robot.torque
        self._wheels = [joints["wheel_left_joint"], joints["wheel_right_joint"]]
        names = ("front_left_joint", "front_right_joint") if robot.steered else ()
        front = [joints[name] for name in names]
        if robot.friction != 1.0:  # as in the URDF
            for wheel in (*self._wheels, *front):
                pybullet.changeDynamics(body, wheel, lateralFriction=robot.friction, physicsClientId=client)
        self.turn_wheels(0.0, 0.0)
        if robot.steered:
            self._front = [joints["steer_left_joint"], joints["steer_right_joint"]]
            pybullet.setJointMotorControlArray(  # they roll freely: PyBullet brakes joints by default
                body, front, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(front), physicsClientId=client
            )
            self.steer(0.0, 0.0)

    def turn_wheels(self, left: float, right: float) -> None:  # noqa: D102 - see WheelBase
        pybullet.setJointMotorControlArray(
            self._body,
            self._wheels,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=(left, right),
            forces=[self._torque] * 2,
            physicsClientId=self._client,
        )

    def steer(self, left: float, right: float) -> None:  # noqa: D102
        pybullet.setJointMotorControlArray(
            self._body,
            self._front,
            pybullet.POSITION_CONTROL,
            targetPositions=(left, right),
            forces=[_STEERING_TORQUE] * 2,
            physicsClientId=self._client,
        )

    def wheel_angles(self) -> tuple[float, float]:  # noqa: D102
        left, right = pybullet.getJointStates(self._body, self._wheels, physicsClientId=self._client)
        return left[0], right[0]

    def pose(self) -> Array:  # noqa: D102
        (x, y, _), q = pybullet.getBasePositionAndOrientation(self._body, physicsClientId=self._client)
        return np.array((x, y, math.atan2(2 * (q[3] * q[2] + q[0] * q[1]), 1 - 2 * (q[1] * q[1] + q[2] * q[2]))))

    def velocity(self) -> Array:  # noqa: D102
        linear, angular = pybullet.getBaseVelocity(self._body, physicsClientId=self._client)
        return np.array((linear[0], linear[1], angular[2]))

    def quaternion(self) -> tuple[float, float, float, float]:  # noqa: D102
        attitude: tuple[float, float, float, float]
        _, attitude = pybullet.getBasePositionAndOrientation(self._body, physicsClientId=self._client)
        return attitude


class PybulletMover:
    """A `MovingDisc` in PyBullet: a heavy body, because contacts ignore the speed of a massless one.

    Attributes:
        body: PyBullet id of the body.
    """

    def __init__(self, client: int, rate: int, plane: str, disc: Disc) -> None:
        self._client = client
        _, self._place, self._attitude = placed(disc, plane)
        self._second = 1 if plane == "xy" else 2
        self._lift = GRAVITY / rate if plane == "xy" else 0.0  # speed gained from gravity in a step
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_CYLINDER,
            radius=disc.radius,
            height=WALL_HEIGHT if plane == "xy" else SLAB_DEPTH,
            physicsClientId=client,
        )
        self.body: int = pybullet.createMultiBody(
            MOVER_MASS, shape, -1, self._place, self._attitude, physicsClientId=client
        )
        pybullet.changeDynamics(self.body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client)
        pybullet.setCollisionFilterGroupMask(
            self.body, -1, _STATIC_GROUP, ALL_GROUPS & ~_STATIC_GROUP, physicsClientId=client
        )

    def move(self, position: tuple[float, float], velocity: tuple[float, float]) -> None:  # noqa: D102
        self._place[0], self._place[self._second] = position
        speed = [velocity[0], 0.0, self._lift]
        speed[self._second] += velocity[1]
        pybullet.resetBasePositionAndOrientation(self.body, self._place, self._attitude, physicsClientId=self._client)
        pybullet.resetBaseVelocity(self.body, speed, (0.0, 0.0, 0.0), physicsClientId=self._client)


class PybulletJoints:
    """`PlanarJoints` in PyBullet."""

    def __init__(self, client: int, body: int, joints: Mapping[str, int], robot: FlyingRobot) -> None:
        self._client, self._body = client, body
        self._joints = [joints["x"], joints["z"], joints["psi"]]
        pybullet.changeDynamics(
            body,
            self._joints[2],
            mass=robot.mass,
            localInertiaDiagonal=(robot.inertia,) * 3,
            physicsClientId=client,
        )
        for joint, place, rate in zip(self._joints, robot.pose, robot.velocity, strict=True):
            pybullet.resetJointState(body, joint, place, rate, physicsClientId=client)
        pybullet.setJointMotorControlArray(
            body, self._joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * 3, physicsClientId=client
        )

    def push(self, force: Array) -> None:  # noqa: D102 - see PlanarJoints
        pybullet.setJointMotorControlArray(
            self._body, self._joints, pybullet.TORQUE_CONTROL, forces=force.tolist(), physicsClientId=self._client
        )

    def pose(self) -> Array:  # noqa: D102
        return np.array([joint[0] for joint in self._states()])

    def velocity(self) -> Array:  # noqa: D102
        return np.array([joint[1] for joint in self._states()])

    def _states(self) -> tuple[tuple[float, float], ...]:
        states: tuple[tuple[float, float], ...]
        states = pybullet.getJointStates(self._body, self._joints, physicsClientId=self._client)
        return states

"""Robot bodies that execute commands in a physics world, behind one protocol for all engines.

A body takes two commands within its limits, and has a pose in the task's plane.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

import numpy as np
from ctrl_rl_core.tasks import MODEL
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Robot, System
from sim_bridge.engines.engine import Engine, FlyingRobot, PlanarJoints, WheeledRobot
from sim_bridge.errors import SimulationError
from sim_bridge.simulation.lidar import SensorPose
from sim_bridge.simulation.model_body import ModelBody
from sim_bridge.simulation.options import SimulationOptions
from sim_bridge.simulation.robot_urdf import urdf_of
from sim_bridge.simulation.wheeled_bodies import CarDrive, DifferentialDrive, drive_of

Array = NDArray[np.float64]


class Body(Protocol):
    """A robot's body in the physics world.

    Attributes:
        radius: Radius of a circle around its origin that encloses the body [m].
        bounds: Minimum and maximum commands (2, 2): [v, omega] [m/s, rad/s] or [t1, t2] [N].
        idle: Command without input (2,).
    """

    radius: float
    bounds: Array
    idle: Array

    def act(self, command: Array) -> None:
        """Apply a command (2,) within `bounds` for the next physics step."""

    def pose(self) -> Array:
        """Return x, y, theta or x, z, psi (3,) [m, m, rad]."""

    def velocity(self) -> Array:
        """Return the rates of `pose` (3,) [m/s, m/s, rad/s]."""

    def state(self) -> Array | None:
        """Return the state of the task's system (n,); None if it follows from pose and velocity."""

    def quaternion(self) -> tuple[float, float, float, float]:
        """Return the body's attitude (x, y, z, w)."""

    def sensor(self) -> SensorPose:
        """Return the lidar's frame."""

    def wheel_angles(self) -> tuple[float, float] | None:
        """Return the angles of the left and right wheel [rad]; None without wheels."""

    def top_speed(self, horizon: float) -> float:
        """Return an upper bound on the speed of any point of the body within the next `horizon` seconds [m/s]."""


class PlanarQuadrotor:
    """Two rotor pairs in the x-z plane, thesis Eq. 3.10; a `Body`.

    Plain engine steps are first order. Here joint speeds lag by half a step (leapfrog, second order): the first force
    lasts half a step, and when the command changes, the old and the new forces act for half a step each.
    """

    def __init__(self, joints: PlanarJoints, rate: int, system: System, radius: float) -> None:
        """Float freely until the first command.

        Args:
            joints: The robot in the engine.
            rate: Physics steps per second [Hz].
            system: Model of thesis Eq. 3.10 with its parameters.
            radius: Radius of a circle that encloses the robot [m].
        """
        self._joints, self._rate = joints, rate
        self._rates = system.equations(math, system.parameters)
        mass, inertia = system.parameters["m"], system.parameters["I_yy"]
        self._weight = np.array((mass, mass, inertia))
        self.bounds = system.control_bounds.T
        self.idle = np.clip(np.full(2, 0.5 * mass * system.parameters["g"]), self.bounds[:, 0], self.bounds[:, 1])
        self.radius = radius
        self._command: Array | None = None
        self._acceleration = np.zeros(3)

    def act(self, command: Array) -> None:  # noqa: D102
        x, z, psi = self.pose().tolist()
        v_x, v_z, omega = self.velocity().tolist()
        state = (x, v_x, z, v_z, psi, omega)
        now = self._accelerations(state, command)
        before = now if command is self._command else self._accelerations(state, self._command)
        self._command, self._acceleration = command, now
        force = 0.5 * (before + now) * self._weight
        self._joints.push(force)

    def _accelerations(self, state: tuple[float, ...], command: Array | None) -> Array:
        if command is None:
            return np.zeros(3)
        rates = self._rates(state, command.tolist(), (0.0,) * 6)
        return np.array((rates[1], rates[3], rates[5]))

    def pose(self) -> Array:  # noqa: D102
        return self._joints.pose()

    def velocity(self) -> Array:  # noqa: D102
        return self._joints.velocity() + 0.5 / self._rate * self._acceleration

    def state(self) -> Array | None:  # noqa: D102
        return None

    def quaternion(self) -> tuple[float, float, float, float]:  # noqa: D102
        psi = float(self.pose()[2])
        return 0.0, math.sin(0.5 * psi), 0.0, math.cos(0.5 * psi)

    def sensor(self) -> SensorPose:  # noqa: D102
        x, z, psi = self.pose()
        c, s = math.cos(psi), math.sin(psi)
        return SensorPose(np.array((x, 0.0, z)), np.array(((c, 0.0, -s), (s, 0.0, c))))

    def wheel_angles(self) -> tuple[float, float] | None:  # noqa: D102
        return None

    def top_speed(self, horizon: float) -> float:  # noqa: D102
        v_x, v_z, omega = self.velocity()
        strongest, unequal = self.bounds[:, 1], (self.bounds[0, 1], self.bounds[1, 0])
        push = self._rates((0.0,) * 6, strongest, (0.0,) * 6)[3]
        turn = self._rates((0.0,) * 6, unequal, (0.0,) * 6)[5]
        return float(
            math.hypot(v_x, v_z) + (abs(push) + 9.81) * horizon + self.radius * (abs(omega) + abs(turn) * horizon)
        )


def make_body(engine: Engine, task: NavigationTask, system: System, state: Array, options: SimulationOptions) -> Body:
    """Add the task's robot to the world at a start state (n,), in its system's order.

    Raises:
        SimulationError: The state is invalid for the body.
    """
    named = dict(zip(system.state_names, state.tolist(), strict=True))
    radius = task.robot.radius
    if task.robot.body != MODEL and task.plane == "xz":
        pose, velocity = _take(task, named, "x", "z", "psi"), _take(task, named, "v_x", "v_z", "omega")
        mass, inertia = (system.parameters[name] for name in ("m", "I_yy"))
        joints = engine.add_flying(FlyingRobot(str(urdf_of(_robot(task))), pose, velocity, mass, inertia))
        return PlanarQuadrotor(joints, engine.rate, system, radius)
    if task.robot.body == MODEL:
        limits = np.array(list(task.robot.commands.values()))
        return ModelBody(engine.add_disc(radius), system, limits, state, radius, engine.rate)
    drive = drive_of(task)
    bounds = np.array([task.robot.commands[name] for name in ("v", "omega")])
    pose = _take(task, named, "x", "y", "theta")
    steered = drive.steering is not None
    base = engine.add_wheeled(WheeledRobot(drive.urdf, pose, drive.torque, options.friction, steered))
    return (CarDrive if steered else DifferentialDrive)(base, drive, bounds, radius, options)


def _robot(task: NavigationTask) -> Robot:
    """Return the robot of a task whose body is not `MODEL`."""
    assert task.robot.robot is not None
    return task.robot.robot


def _take(task: NavigationTask, state: Mapping[str, float], *names: str) -> Array:
    """Return state components, selected by name, as an array."""
    if missing := set(names) - state.keys():
        raise SimulationError(
            f"task '{task.name}': body '{task.robot.body}' needs a system with {', '.join(sorted(missing))}: "
            f"'{task.system.model}' has {', '.join(state)}"
        )
    return np.array([state[name] for name in names])

"""Vectorised motion models of a fleet, with the equations of the planar engine."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from ctrl_rl_core.tasks import ANGLES, MODEL
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Robot, System
from sim_bridge.engines.planar_motion import RollingDrives
from sim_bridge.engines.planar_parts import Outline, disc_outline, outline
from sim_bridge.errors import SimulationError
from sim_bridge.simulation.model_body import LIDAR_HEIGHT, advance
from sim_bridge.simulation.robot_urdf import urdf_of
from sim_bridge.simulation.wheeled_bodies import drive_of

Array = NDArray[np.float64]


class FleetMotion(Protocol):
    """Robots of one kind, each with its own commands.

    Attributes:
        outline: Collision shapes of a robot.
        lidar: Lidar mounting: position along and across the robot [m], height [m] and direction [rad] (4,).
        poses: Poses x, y, theta or x, z, psi (N, 3) [m, m, rad].
    """

    outline: Outline
    lidar: tuple[float, float, float, float]
    poses: Array

    def begin(self, index: int, state: dict[str, float]) -> None:
        """Set a robot's state, given by component."""

    def command(self, commands: Array) -> None:
        """Set new commands of all robots (N, 2), within the task's bounds."""

    def advance(self) -> None:
        """Move by one physics step."""

    def velocities(self) -> Array:
        """Return the rates of the poses (N, 3) [m/s, m/s, rad/s]."""

    def states(self) -> Array | None:
        """Return the states of the task's system (N, n); None if they follow from poses and velocities."""


class WheeledMotion:
    """Differential drives, see `RollingDrives`."""

    def __init__(self, task: NavigationTask, size: int, rate: int) -> None:
        drive = drive_of(task)
        if drive.steering is not None:
            raise SimulationError(f"task '{task.name}': a fleet has no steered wheels: simulate one car at a time")
        self.outline, self.lidar = outline(drive.urdf, "xy"), (*drive.lidar, drive.lidar_yaw)
        self._drive, self._drives = drive, RollingDrives(drive.urdf, drive.torque, size, rate, drive.lag)
        self.poses = self._drives.poses
        self._limits = None if drive.bounds is None else np.array(drive.bounds).T

    def begin(self, index: int, state: dict[str, float]) -> None:  # noqa: D102 - see FleetMotion
        self._drives.begin(index, [state[name] for name in ("x", "y", "theta")])

    def command(self, commands: Array) -> None:  # noqa: D102
        within = commands if self._limits is None else np.clip(commands, *self._limits)
        turn = 0.5 * self._drive.wheel_separation * within[:, 1]
        speeds = np.stack((within[:, 0] - turn, within[:, 0] + turn), axis=1)
        self._drives.wanted[:] = speeds / self._drive.wheel_radius

    def advance(self) -> None:  # noqa: D102
        self._drives.advance()

    def velocities(self) -> Array:  # noqa: D102
        return self._drives.velocities()

    def states(self) -> Array | None:  # noqa: D102
        return None


class FlyingMotion:
    """Planar quadrotors (thesis Eq. 3.10), integrated by the leapfrog scheme of `simulation.bodies.PlanarQuadrotor`."""

    lidar = (0.0, 0.0, 0.0, 0.0)

    def __init__(self, robot: Robot, system: System, size: int, rate: int) -> None:
        self.outline = outline(str(urdf_of(robot)), "xz")
        self._equations = system.equations(np, system.parameters)
        self._step = 1.0 / rate
        self.poses, self._speeds = np.zeros((size, 3)), np.zeros((size, 3))
        self._acceleration, self._command = np.zeros((size, 3)), np.zeros((size, 2))
        self._new, self._moving = False, np.zeros(size, dtype=bool)
        self._before = self._command

    def begin(self, index: int, state: dict[str, float]) -> None:  # noqa: D102 - see FleetMotion
        self.poses[index] = [state[name] for name in ("x", "z", "psi")]
        self._speeds[index] = [state[name] for name in ("v_x", "v_z", "omega")]
        self._acceleration[index] = 0.0
        self._moving[index] = False

    def command(self, commands: Array) -> None:  # noqa: D102
        self._before, self._command, self._new = self._command, commands, True

    def advance(self) -> None:  # noqa: D102
        state = np.empty((6, len(self.poses)))
        state[0::2], state[1::2] = self.poses.T, self.velocities().T
        now = self._accelerations(state, self._command)
        before = now
        if self._new:
            before = np.where(self._moving[:, None], self._accelerations(state, self._before), 0.0)
            self._new, self._moving[:] = False, True
        self._acceleration = now
        self._speeds += 0.5 * (before + now) * self._step
        self.poses += self._speeds * self._step

    def velocities(self) -> Array:  # noqa: D102
        return self._speeds + 0.5 * self._step * self._acceleration

    def states(self) -> Array | None:  # noqa: D102
        return None

    def _accelerations(self, state: Array, commands: Array) -> Array:
        rates = self._equations(state, commands.T, (0.0,) * 6)
        return np.stack((rates[1], rates[3], rates[5]), axis=1)


class ModelMotion:
    """Discs that move exactly as the task's system model, see `simulation.model_body`."""

    lidar = (0.0, 0.0, LIDAR_HEIGHT, 0.0)

    def __init__(self, task: NavigationTask, system: System, size: int, rate: int) -> None:
        self.outline = disc_outline(task.robot.radius)
        self._system, self._step = system, 1.0 / rate
        names = list(system.state_names)
        self._pose = [names.index("x"), names.index(task.plane[1])]
        self._pose += [index for index, name in enumerate(names) if name in ANGLES][:1]
        self._states, self._commands = np.zeros((size, len(names))), np.zeros((size, 2))
        self.poses = np.zeros((size, 3))

    def begin(self, index: int, state: dict[str, float]) -> None:  # noqa: D102 - see FleetMotion
        self._states[index] = list(state.values())
        self._place()

    def command(self, commands: Array) -> None:  # noqa: D102
        self._commands = commands

    def advance(self) -> None:  # noqa: D102
        self._states = advance(self._system, self._states, self._commands, self._step)
        self._place()

    def _place(self) -> None:
        self.poses[:, : len(self._pose)] = self._states[:, self._pose]

    def velocities(self) -> Array:  # noqa: D102
        rates = np.zeros_like(self.poses)
        rates[:, : len(self._pose)] = self._system.dynamics(self._states, self._commands)[:, self._pose]
        return rates

    def states(self) -> Array | None:  # noqa: D102
        return self._states.copy()


def make_motion(task: NavigationTask, system: System, size: int, rate: int) -> FleetMotion:
    """Return the motion model for a task's robots."""
    if task.robot.robot is not None and task.plane == "xz":
        return FlyingMotion(task.robot.robot, system, size, rate)
    if task.robot.body == MODEL:
        return ModelMotion(task, system, size, rate)
    return WheeledMotion(task, size, rate)

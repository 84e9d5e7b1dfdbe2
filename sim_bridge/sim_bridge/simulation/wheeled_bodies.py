"""Bodies on wheels: differential drives, and cars with steered front wheels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Steering
from sim_bridge.engines.engine import WheelBase
from sim_bridge.errors import SimulationError
from sim_bridge.simulation.lidar import SensorPose
from sim_bridge.simulation.options import SimulationOptions
from sim_bridge.simulation.robot_urdf import urdf_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DriveParameters:
    """Parameters of a differential drive.

    Attributes:
        urdf: Path of the URDF file.
        wheel_radius: Radius of the wheels [m].
        wheel_separation: Distance between the wheels [m].
        torque: Maximum torque of one wheel [N m].
        lag: Time constant of the wheel speed [s].
        bounds: Minimum and maximum v [m/s] and omega [rad/s]; None for the task's command bounds.
        lidar: Position of the lidar in base_footprint (3,) [m].
        lidar_yaw: Direction of the lidar's zero bearing [rad].
        steering: Steered front wheels; None without.
    """

    urdf: str
    wheel_radius: float
    wheel_separation: float
    torque: float
    lag: float
    bounds: tuple[tuple[float, float], tuple[float, float]] | None
    lidar: tuple[float, float, float]
    lidar_yaw: float
    steering: Steering | None = None


def drive_of(task: NavigationTask) -> DriveParameters:
    """Return the drive parameters of a task's robot.

    Raises:
        SimulationError: The robot has no wheels.
    """
    robot = task.robot.robot
    if robot is None or robot.wheels is None:
        raise SimulationError(f"task '{task.name}': robot '{task.robot.body}' has no wheels to drive")
    wheels, lidar, (low, high) = robot.wheels, robot.lidar, robot.limits
    bounds = ((low[0], high[0]), (low[1], high[1])) if wheels.limited else None
    place = lidar.x, lidar.y, lidar.z
    return DriveParameters(
        str(urdf_of(robot)),
        wheels.radius,
        wheels.separation,
        wheels.torque,
        wheels.lag,
        bounds,
        place,
        lidar.yaw,
        robot.steering,
    )


class DifferentialDrive:
    """Two wheels on velocity motors with a first-order lag and limited torque, standing on a floor; a `Body`."""

    def __init__(
        self, base: WheelBase, drive: DriveParameters, bounds: Array, radius: float, options: SimulationOptions
    ) -> None:
        """Start at rest.

        Args:
            base: The robot in the engine.
            drive: Parameters of the drive.
            bounds: Minimum and maximum commands, if the drive has none (2, 2).
            radius: Radius of a circle that encloses the robot [m].
            options: Settings of the episode.
        """
        self._base, self._drive = base, drive
        self.bounds = bounds if drive.bounds is None else np.array(drive.bounds)
        self.idle = np.zeros(2)
        self.radius = radius
        lag = drive.lag if options.motor_lag is None else options.motor_lag
        self._share = -math.expm1(-1.0 / (options.rate * lag))
        self._counted = drive.wheel_radius / options.wheel_radius  # rotates as if the wheels had their true radius
        self._speeds = (0.0, 0.0)
        v, omega = np.abs(self.bounds).max(axis=1)
        self._top_speed = float(1.2 * (v + omega * radius) * (drive.wheel_radius / self._counted))

    def act(self, command: Array) -> None:  # noqa: D102 - see Body
        v, turn = float(command[0]), 0.5 * self._drive.wheel_separation * float(command[1])
        left, right = self._speeds
        wanted = ((v - turn) / self._counted, (v + turn) / self._counted)
        if wanted == self._speeds:
            return
        left += self._share * (wanted[0] - left)
        right += self._share * (wanted[1] - right)
        settled = abs(left - wanted[0]) + abs(right - wanted[1]) < 1e-6
        self._speeds = wanted if settled else (left, right)
        self._base.turn_wheels(*self._speeds)

    def pose(self) -> Array:  # noqa: D102
        return self._base.pose()

    def velocity(self) -> Array:  # noqa: D102
        return self._base.velocity()

    def state(self) -> Array | None:  # noqa: D102
        return None

    def quaternion(self) -> tuple[float, float, float, float]:  # noqa: D102
        return self._base.quaternion()

    def sensor(self) -> SensorPose:  # noqa: D102
        x, y, theta = self.pose()
        c, s = math.cos(theta), math.sin(theta)
        along, aside, height = self._drive.lidar
        origin = np.array((x + c * along - s * aside, y + s * along + c * aside, height))
        if self._drive.lidar_yaw:
            c, s = math.cos(theta + self._drive.lidar_yaw), math.sin(theta + self._drive.lidar_yaw)
        return SensorPose(origin, np.array(((c, s, 0.0), (-s, c, 0.0))))

    def wheel_angles(self) -> tuple[float, float] | None:  # noqa: D102
        left, right = self._base.wheel_angles()
        share = self._counted / self._drive.wheel_radius
        return share * left, share * right

    def top_speed(self, horizon: float) -> float:  # noqa: ARG002, D102 - its wheels bound it
        return self._top_speed


class CarDrive(DifferentialDrive):
    """A car: the rear wheels of a `DifferentialDrive`, and front wheels that are steered as fast as they can be.

    A command (v, omega) asks for the curvature omega / v; at v = 0 the front wheels stay as they are. The car turns by
    the angle that its wheels have, so a curvature beyond the tightest turn is cut.
    """

    def __init__(
        self, base: WheelBase, drive: DriveParameters, bounds: Array, radius: float, options: SimulationOptions
    ) -> None:
        super().__init__(base, drive, bounds, radius, options)
        assert drive.steering is not None
        self._steering, self._angle, self._speed = drive.steering, 0.0, 0.0
        lag = drive.steering.lag
        self._fraction = -math.expm1(-1.0 / (options.rate * lag)) if lag else 1.0
        self._most = drive.steering.rate / options.rate

    def act(self, command: Array) -> None:  # noqa: D102 - see Body
        v, omega = float(command[0]), float(command[1])
        base = self._steering.wheelbase
        if v != 0.0:
            limit = self._steering.angle
            wanted = min(max(math.atan(base * omega / v), -limit), limit)
            change = self._fraction * (wanted - self._angle)
            self._angle += min(max(change, -self._most), self._most)
        curvature = math.tan(self._angle) / base
        beside = 0.5 * self._drive.wheel_separation * curvature
        # Both front wheels roll about the same point on the line of the rear axle (Ackermann).
        left, right = (math.atan(base * curvature / (1.0 + side * beside)) for side in (-1.0, 1.0))
        self._base.steer(left, right)
        # The front wheels alone say how tight the turn is, so the motors' lag delays the speed, not the curvature.
        self._speed += self._share * (v - self._speed)
        left, right = (self._speed * (1.0 + side * beside) / self._counted for side in (-1.0, 1.0))
        self._base.turn_wheels(left, right)

"""The reactive planner of a delivery team's robots, from a pose and nearby points to a velocity. No map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.sensing import echoes
from ctrl_rl_core.tasks import wrap
from numpy.typing import NDArray

from ctrl_rl_core import Disc, ScanGeometry, Shape

Array = NDArray[np.float64]

STAND = (0.0, 0.0)
_SPACING = 0.05


@dataclass(frozen=True)
class ReactivePlanner:
    """Computes speed and turn rate towards a goal.

    Attributes:
        speed: Maximum forward speed [m/s].
        turn: Maximum turn rate [rad/s].
        half_width: Half-width of the strip that must be free of obstacles [m].
        look_ahead: Length of the strip that must be free [m].
        stop: Distance from the robot's centre to an obstacle ahead at which the robot stops [m].
        arrived: Distance to the goal at which the robot has arrived [m].
        clearance: Distance to walls and obstacles that a goal needs [m].
        passage: Width that a passage needs, so that a robot also gets out of it again if it meets another one [m].
    """

    speed: float = 0.2
    turn: float = 1.5
    half_width: float = 0.24
    look_ahead: float = 0.55
    stop: float = 0.27
    arrived: float = 0.08
    clearance: float = 0.3
    passage: float = 0.7

    def there(self, pose: Array, place: tuple[float, float]) -> bool:
        """Return whether a pose x, y, theta (3,) is at the goal."""
        return math.hypot(place[0] - pose[0], place[1] - pose[1]) <= self.arrived

    def command(self, pose: Array, points: Array, place: tuple[float, float]) -> tuple[float, float]:
        """Return speed [m/s] and turn rate [rad/s].

        The planner takes the free direction nearest to the goal's; ties go to the right, so that two robots that meet
        pass each other.

        Args:
            pose: Pose x, y [m], theta [rad] (3,).
            points: Points seen by the lidar, in the frame of the pose (n, 2) [m].
            place: Goal position [m].
        """
        points = seen_from(pose, points)
        dx, dy = place[0] - pose[0], place[1] - pose[1]
        distance, bearing = math.hypot(dx, dy), float(wrap(math.atan2(dy, dx) - pose[2]))
        if distance <= self.arrived:
            return STAND
        direction = self._free_direction(points, bearing, min(distance, self.look_ahead))
        if direction is None:
            return 0.0, -0.5 * self.turn
        turn = float(np.clip(2.5 * direction, -self.turn, self.turn))
        speed = min(self.speed, distance) * max(0.0, math.cos(direction)) ** 3
        if abs(direction) > 1.0 or self._nearest(points, 0.0) < self.stop:
            speed = 0.0
        return speed, turn

    def _free_direction(self, points: Array, bearing: float, reach: float) -> float | None:
        """Return the free direction nearest to a bearing; if there is none, accept one free for half the distance."""
        for far in (reach, 0.5 * reach):
            for offset in np.deg2rad(np.arange(0, 111, 10)):
                for direction in (bearing - offset, bearing + offset):
                    if self._nearest(points, direction) > far:
                        return float(wrap(direction))
        return None

    def _nearest(self, points: Array, direction: float) -> float:
        """Return the free distance along the strip in a direction [m]."""
        c, s = math.cos(direction), math.sin(direction)
        along, aside = c * points[:, 0] + s * points[:, 1], c * points[:, 1] - s * points[:, 0]
        inside = along[(np.abs(aside) < self.half_width) & (along > 0.0)]
        return float(inside.min()) if len(inside) else math.inf


def scan_points(pose: Array, ranges: NDArray[np.float32], scan: ScanGeometry, forward: float) -> Array:
    """Return a scan's echoes as points (n, 2) [m] in the frame of the pose, which does not rotate with the robot.

    Args:
        pose: Pose x, y [m], theta [rad] (3,) of the robot at the time of the scan.
        ranges: Ranges as in REP-117 (beams,) [m].
        scan: Bearings and limits of the beams.
        forward: Position of the lidar ahead of the robot's centre [m].
    """
    points = echoes(ranges, scan, math.inf, forward)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray(pose[:2] + points @ np.array(((c, s), (-s, c))))


def seen_from(pose: Array, points: Array) -> Array:
    """Transform points to the robot's frame, x ahead."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray((points - pose[:2]) @ np.array(((c, -s), (s, c))))


def outline(shape: Shape) -> Array:
    """Return points (n, 2) on the edge of a shape [m]."""
    if isinstance(shape, Disc):
        angles = np.linspace(0.0, 2.0 * np.pi, max(8, round(2.0 * np.pi * shape.radius / _SPACING)), endpoint=False)
        return shape.centre + shape.radius * np.column_stack((np.cos(angles), np.sin(angles)))
    half = 0.5 * np.asarray(shape.size)
    edges = []
    for client in (0, 1):
        along = np.linspace(-half[client], half[client], max(2, round(shape.size[client] / _SPACING) + 1))
        for end in (-half[1 - client], half[1 - client]):
            edge = np.full((len(along), 2), end)
            edge[:, client] = along
            edges.append(edge)
    c, s = np.cos(shape.angle), np.sin(shape.angle)
    return shape.centre + np.concatenate(edges) @ np.array(((c, s), (-s, c)))

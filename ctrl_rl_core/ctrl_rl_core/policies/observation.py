"""Builds the observation that a policy was learnt with, from what the robot senses."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.driving.scan import ScanGeometry, nearest_beams
from ctrl_rl_core.geometry.odometry import OdometryReader
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import COMMAND_NAMES, NamedPart, Part, PolicyManifest, ScanPart
from ctrl_rl_core.tasks.regions import wrap

Array = NDArray[np.float64]


class Sensors(NamedTuple):
    """What a robot senses at the time of a scan.

    Attributes:
        ranges: Ranges of the scan's beams (beams,) [m].
        scan: Bearings and limits of the beams in the robot's frame.
        odometry: The last nav_msgs/Odometry, from rclpy or a bag.
        pose: Pose x, y, theta (3,) [m, m, rad]; None where it is unknown.
        goal: Goal x, y, theta in the frame of the pose (3,) [m, m, rad]; None where there is none.
        command: Last command (2,).
    """

    ranges: NDArray[np.float32]
    scan: ScanGeometry
    odometry: Any
    pose: Array | None
    goal: Array | None
    command: Array


class ObservationBuilder:
    """Builds the observations of one policy."""

    def __init__(self, manifest: PolicyManifest) -> None:
        parts = manifest.observation
        self._read = [_reader(part, manifest.robot) for part in parts]
        self._low, self._high, self._middle, self._unit = (
            np.concatenate([part.spread(name) for part in parts]).astype(np.float32)
            for name in ("low", "high", "middle", "unit")
        )

    def __call__(self, sensors: Sensors) -> NDArray[np.float32]:
        """Return the observation (n,) in the policy's own units.

        Raises:
            PolicyError: A part of it is unknown, or not finite.
        """
        values = np.concatenate([read(sensors) for read in self._read]).astype(np.float32)
        if not np.isfinite(values).all():
            raise PolicyError("odometry, pose or goal hold numbers that are not finite")
        clipped = np.minimum(np.maximum(values, self._low), self._high)
        return np.asarray((clipped - self._middle) / self._unit, dtype=np.float32)


def _reader(part: Part, robot: str) -> Callable[[Sensors], Array]:
    if isinstance(part, ScanPart):
        return _ScanReader(part)
    if part.source == "odometry":
        read = OdometryReader(part.names)
        return lambda sensors: read(sensors.odometry)
    if part.source == "pose":
        return lambda sensors: _pose(part, sensors)
    if part.source == "goal":
        return lambda sensors: _goal(part, sensors)
    places = [COMMAND_NAMES[robot].index(name) for name in part.names]
    return lambda sensors: sensors.command[places]


def _pose(part: NamedPart, sensors: Sensors) -> Array:
    if sensors.pose is None:
        raise PolicyError("no pose yet")
    x, y, theta = sensors.pose.tolist()
    known = {"x": x, "y": y, "theta": theta, "cos_theta": math.cos(theta), "sin_theta": math.sin(theta)}
    return np.array([known[name] for name in part.names])


def _goal(part: NamedPart, sensors: Sensors) -> Array:
    if sensors.goal is None:
        raise PolicyError("no goal yet")
    if sensors.pose is None:
        raise PolicyError("no pose yet")
    x, y, theta = sensors.pose.tolist()
    goal_x, goal_y, goal_theta = sensors.goal.tolist()
    east, north = goal_x - x, goal_y - y
    cos, sin = math.cos(theta), math.sin(theta)
    ahead, left = cos * east + sin * north, cos * north - sin * east
    bearing = math.atan2(left, ahead)
    known = {
        "x": goal_x,
        "y": goal_y,
        "theta": goal_theta,
        "distance": math.hypot(ahead, left),
        "bearing": bearing,
        "cos_bearing": math.cos(bearing),
        "sin_bearing": math.sin(bearing),
        "ahead": ahead,
        "left": left,
        "turn": float(wrap(goal_theta - theta)),
    }
    return np.array([known[name] for name in part.names])


class _ScanReader:
    """Ranges at fixed bearings, from scans of any lidar."""

    def __init__(self, part: ScanPart) -> None:
        self._part = part
        self._geometry: ScanGeometry | None = None
        self._beams: NDArray[np.intp] = np.empty((0, 0), np.intp)

    def __call__(self, sensors: Sensors) -> Array:
        """Return the ranges (count,) [m].

        Raises:
            PolicyError: The lidar does not look in one of the directions.
        """
        part, scan, ranges = self._part, sensors.scan, sensors.ranges
        if scan != self._geometry:  # an LDS-02 never turns twice at the same speed
            self._beams, self._geometry = self._find(scan), scan
        values = ranges[self._beams].astype(np.float64)
        values[(values == 0.0) | np.isnan(values)] = math.inf  # an LDS-01 writes 0 for a miss
        values[values > scan.range_max] = math.inf
        near = values.min(axis=1) if part.reduce == "least" else np.median(values, axis=1)
        return np.asarray(np.clip(near, part.low, part.high), dtype=np.float64)

    def _find(self, scan: ScanGeometry) -> NDArray[np.intp]:
        """Return the beams of each bearing (count, most in one); rows are filled up with the nearest beam."""
        part = self._part
        field, nearest = nearest_beams(scan, part.bearings)
        if not field.all():
            degrees = math.degrees(float(part.bearings[~field][0]))
            raise PolicyError(f"the lidar does not look to {degrees:.0f} deg, where the policy does")
        if part.half_width == 0.0:
            return nearest[:, None]
        bearings = scan.angle_min + scan.angle_increment * np.arange(scan.beams)
        within = np.abs(wrap(bearings - part.bearings[:, None])) <= part.half_width
        most = max(1, int(within.sum(axis=1).max()))
        order = np.argsort(~within, axis=1, kind="stable")[:, :most]
        return np.where(np.take_along_axis(within, order, axis=1), order, nearest[:, None])

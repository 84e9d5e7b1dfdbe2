"""Builds a learnt policy's observation from the robot's sensor readings."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import COMMAND_NAMES, NamedPart, Part, PolicyManifest, ScanPart
from ctrl_rl_core.sensing.odometry import OdometryReader
from ctrl_rl_core.sensing.resampling import Sectors
from ctrl_rl_core.sensing.scan import Sensors
from ctrl_rl_core.tasks.regions import wrap

Array = NDArray[np.float64]
_HEADINGS = {"theta", "turn"}


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
            PolicyError: A component is unknown or not finite.
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
    if math.isnan(goal_theta) and not _HEADINGS.isdisjoint(part.names):
        raise PolicyError("the goal has no heading")
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
        bearings = tuple(part.bearings.tolist())
        self._sectors = Sectors(bearings, part.half_width, part.high, part.reduce)

    def __call__(self, sensors: Sensors) -> Array:
        """Return the ranges (count,) [m].

        Raises:
            PolicyError: The lidar does not cover one of the bearings.
            ScanError: The scan is unusable or contains no measurement.
        """
        distances = self._sectors.distances(sensors.ranges, sensors.scan)
        unseen = self._sectors.unseen(sensors.scan)
        if len(unseen):
            degrees = math.degrees(float(unseen[0]))
            raise PolicyError(f"the lidar does not look to {degrees:.0f} deg, where the policy does")
        return np.maximum(distances, self._part.low)

"""Publishes the pose of the odometry frame in the map (REP-105), like a localiser."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from ctrl_rl_core.ros import LATCHED, to_stamp
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from rclpy.node import Node

from sim_bridge.ros.frames import WORLD_FRAME, CountedPublisher, Frames, transform
from sim_bridge.ros.pacing import Schedule
from sim_bridge.simulation.draws import Purpose, stream
from sim_bridge.simulation.odometry import Array, Localiser, correction
from sim_bridge.simulation.world import SimulatedWorld

KINDS = ("none", "exact", "noisy")
"""Kinds of localisation: none (an external localiser is used), true pose, or pose with errors."""


class LocalisationPublisher:
    """Publishes `amcl_pose` and the transform from `map` to the odometry frame, for one robot.

    Attributes:
        publisher: Publisher of `amcl_pose`; None without localisation.
    """

    def __init__(
        self, node: Node, world: SimulatedWorld, robot: int, frames: Frames, settings: Mapping[str, Any]
    ) -> None:
        self._world, self._robot, self._frames = world, robot, frames
        noisy = settings["localisation"] == "noisy"
        self._error: float = settings["localisation_error"] if noisy else 0.0
        self._heading_error: float = settings["localisation_heading_error"] if noisy else 0.0
        self._rate: float = settings["localisation_rate"]
        self._sense = 1.0 if frames.plane == "xy" else -1.0  # psi is clockwise in the x-z plane
        self.publisher = None
        if settings["localisation"] != "none":
            self.publisher = CountedPublisher(node, PoseWithCovarianceStamped, frames.topic("amcl_pose"), LATCHED)
        self.begin_episode()

    def begin_episode(self) -> None:
        """Start localisation for a new episode."""
        random = stream(self._world.seed, Purpose.LOCALISATION, self._robot)
        self._localiser = Localiser(self._error, self._heading_error, self._rate, random)
        self._schedule = Schedule(self._rate, self._world.options.rate)
        self._correction = np.zeros(3)

    def update(self, time: int, odometry: Array) -> list[TransformStamped]:
        """Send a pose if one is due; return a list with the transform, empty without localisation.

        Args:
            time: Simulation time [ns].
            odometry: Odometry pose (3,).
        """
        if self.publisher is None:
            return []
        if self._schedule.due(self._world.steps):
            pose = self._localiser.update(self._counter_clockwise(self._world.pose(self._robot)))
            self._correction = correction(pose, self._counter_clockwise(odometry))
            self.publisher.publish(self._message(time, pose))
        first, second, angle = self._correction.tolist()
        flat = self._frames.plane == "xy"
        out = transform(WORLD_FRAME, self._frames.odom, (first, second, 0.0) if flat else (first, 0.0, second))
        out.header.stamp = to_stamp(time)
        _turn(out.transform.rotation, angle, flat)
        return [out]

    def _message(self, time: int, pose: Array) -> PoseWithCovarianceStamped:
        out = PoseWithCovarianceStamped()
        out.header.stamp, out.header.frame_id = to_stamp(time), WORLD_FRAME
        flat = self._frames.plane == "xy"
        position = out.pose.pose.position
        position.x, position.y, position.z = (pose[0], pose[1], 0.0) if flat else (pose[0], 0.0, pose[1])
        _turn(out.pose.pose.orientation, pose[2], flat)
        first, second, angle = self._localiser.covariance.tolist()
        for place, variance in zip((0, 7, 35) if flat else (0, 14, 28), (first, second, angle), strict=True):
            out.pose.covariance[place] = variance
        return out

    def _counter_clockwise(self, pose: Array) -> Array:
        return pose * (1.0, 1.0, self._sense)


def _turn(rotation: Any, angle: float, flat: bool) -> None:
    """Write a planar rotation, counter-clockwise [rad], into a quaternion."""
    rotation.w = math.cos(0.5 * angle)
    if flat:
        rotation.z = math.sin(0.5 * angle)
    else:
        rotation.y = -math.sin(0.5 * angle)

"""The pose of the robot for policies that observe it, from odometry, transforms or a localiser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.qos import DurabilityPolicy, QoSProfile

from ctrl_rl_core.navigation.pose_source import LocaliserPose, OdometryTrack, PoseSource, TransformPose
from ctrl_rl_core.navigation.transform_tree import Transform, TransformError, TransformTree
from ctrl_rl_core.ros.node import SENSOR, SuiteNode
from ctrl_rl_core.ros.parameters import Parameter

Array = NDArray[np.float64]
POSE_PARAMETERS = (
    Parameter(
        "pose",
        "odometry",
        "Source of the pose: odometry, the transform from map_frame to the robot, or the topic amcl_pose and odometry "
        "since.",
        choices=("odometry", "tf", "amcl_pose"),
    ),
    Parameter("map_frame", "map", "Frame of the pose by transforms or amcl_pose.", kind="name"),
    Parameter("pose_timeout", 2.0, "Age of a transform above which the robot stops [s].", 0.05, 60.0),
)
_TF = QoSProfile(depth=100)
_STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""QoS for /tf_static: several publishers, each of which sends its transforms once."""


class OdometryPose(PoseSource):
    """The pose in the odometry frame."""

    def __init__(self, track: OdometryTrack, timeout: float) -> None:
        self._track, self._timeout = track, timeout

    def pose(self, now: float) -> Array:
        """Return the latest pose (3,) [m, m, rad] at a steady time [s].

        Raises:
            TransformError: No pose has been received, or it is too old.
        """
        pose, age = self._track.latest().pose, now - self._track.heard
        if not age <= self._timeout:
            raise TransformError(f"no usable pose by odometry for {age:.1f} s")
        return pose

    def frame_in_map(self, frame: str) -> Transform:
        """Return the identity for the odometry frame.

        Raises:
            TransformError: The frame is another one.
        """
        if frame == self._track.frame:
            return Transform.planar(0.0, 0.0, 0.0)
        raise TransformError(f"frame '{frame[:60]}' is unknown: the pose is by odometry, in '{self._track.frame}'")


class PoseInput:
    """Subscribes to the pose source selected by the parameter `pose`.

    Attributes:
        track: Recent odometry poses.
        refused: Reason for rejecting the last invalid message; empty if there was none.
    """

    def __init__(self, node: SuiteNode, timeout: float, now: Callable[[], float]) -> None:
        """Subscribe.

        Args:
            node: Node with the parameters `POSE_PARAMETERS`.
            timeout: Maximum age of odometry [s].
            now: Returns the steady or simulated time [s].
        """
        settings, self.refused, self._now = node.settings, "", now
        self.track = OdometryTrack()
        self._source: PoseSource = OdometryPose(self.track, timeout)
        if settings["pose"] == "amcl_pose":
            self._source = localiser = LocaliserPose(self.track, settings["map_frame"], timeout)
            node.create_subscription(
                PoseWithCovarianceStamped, "amcl_pose", lambda message: self._try(localiser.on_pose, message), SENSOR
            )
        elif settings["pose"] == "tf":
            from tf2_msgs.msg import TFMessage  # part of the workspace build if ROS is not installed

            tree = TransformTree()
            self._source = TransformPose(tree, settings["map_frame"], settings["pose_timeout"])
            for topic, profile, fixed in (("/tf", _TF, False), ("/tf_static", _STATIC, True)):
                node.create_subscription(
                    TFMessage, topic, lambda message, fixed=fixed: self._on_transforms(tree, message, fixed), profile
                )

    def on_odometry(self, message: Odometry, base: str) -> None:
        """Process odometry; take the robot's frame from it unless a parameter names one."""
        self._try(lambda odometry: self.track.update(odometry, self._now()), message)
        if isinstance(self._source, TransformPose):
            self._source.base = base

    def pose(self) -> Array:
        """Return the pose (3,) [m, m, rad].

        Raises:
            TransformError: The pose is unknown or too old.
        """
        return self._source.pose(self._now())

    def place(self, goal: Array, frame: str) -> Array:
        """Transform a pose (3,) from a given frame to the frame of the robot's poses.

        Raises:
            TransformError: The frame is unknown.
        """
        return (self.frame_in_map(frame) @ Transform.planar(*goal.tolist())).pose

    def frame_in_map(self, frame: str) -> Transform:
        """Return the pose of a given frame in the frame of the robot's poses.

        Raises:
            TransformError: The frame is unknown.
        """
        return self._source.frame_in_map(frame)

    def _on_transforms(self, tree: TransformTree, message: Any, fixed: bool) -> None:
        self.refused = tree.update(message, self._now(), fixed) or self.refused

    def _try(self, take: Callable[[Any], None], message: Any) -> None:
        try:
            take(message)
        except TransformError as error:
            self.refused = str(error)

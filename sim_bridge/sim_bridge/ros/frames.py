"""Topic and frame names of one robot, and publishers of messages and transforms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ctrl_rl_core.ros import LATCHED
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # missing in the ROS wheels; scan and odometry do not need it either
    TFMessage = None

WORLD_FRAME = "map"
"""World frame, used for ground truth."""


@dataclass(frozen=True)
class Frames:
    """Topics and frames of one robot: `scan` and `base_link`, or `robot1/scan` and `robot1/base_link`.

    Attributes:
        namespace: Namespace of the robot; empty for none.
        plane: "xy" or "xz".
    """

    namespace: str
    plane: str

    def topic(self, name: str) -> str:
        """Return the full name of a topic or frame of this robot."""
        return f"{self.namespace}/{name}" if self.namespace else name

    @property
    def odom(self) -> str:
        """Frame of the odometry poses."""
        return self.topic("odom")

    @property
    def base(self) -> str:
        """Frame moved by odometry: on the floor below a ground robot, at the centre of a flying one."""
        return self.topic("base_footprint" if self.plane == "xy" else "base_link")

    @property
    def scan(self) -> str:
        """Frame of the lidar."""
        return self.topic("base_scan")


class CountedPublisher:
    """A publisher that counts its messages.

    Attributes:
        topic: Resolved topic name.
        count: Number of messages sent.
    """

    def __init__(self, node: Node, kind: type, topic: str, qos: Any) -> None:
        self._publisher = node.create_publisher(kind, topic, qos)
        self.topic: str = self._publisher.topic_name
        self.count = 0

    def publish(self, message: Any) -> None:
        """Send one message."""
        self._publisher.publish(message)
        self.count += 1


class TransformPublisher:
    """Broadcasts /tf and /tf_static, or nothing if tf2_msgs is missing."""

    def __init__(self, node: Node, fixed: Sequence[TransformStamped]) -> None:
        self._moving = self._fixed = None
        if TFMessage is None:
            return
        self._moving = node.create_publisher(TFMessage, "/tf", 100)
        self._fixed = node.create_publisher(TFMessage, "/tf_static", LATCHED)
        self._fixed.publish(TFMessage(transforms=list(fixed)))

    def publish(self, transforms: Sequence[TransformStamped]) -> None:
        """Send time-varying transforms."""
        if self._moving is not None:
            self._moving.publish(TFMessage(transforms=list(transforms)))


def odometry_transform(odometry: Odometry) -> TransformStamped:
    """Convert an odometry message to a transform."""
    position = odometry.pose.pose.position
    out = transform(odometry.header.frame_id, odometry.child_frame_id, (position.x, position.y, position.z))
    out.header.stamp = odometry.header.stamp
    out.transform.rotation = odometry.pose.pose.orientation
    return out


def transform(parent: str, child: str, translation: tuple[float, float, float]) -> TransformStamped:
    """Create a transform without rotation."""
    out = TransformStamped(child_frame_id=child)
    out.header.frame_id = parent
    out.transform.translation.x, out.transform.translation.y, out.transform.translation.z = translation
    return out

"""Names of topics and frames of one robot, and its transforms where this ROS has tf2_msgs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ctrl_rl_core.ros.node import LATCHED
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from ctrl_rl_core import NavigationTask
from sim_bridge.simulation.bodies import DRIVES

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # the ROS wheels have none; scan and odometry need none either
    TFMessage = None


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
        """Return a topic or frame of this robot."""
        return f"{self.namespace}/{name}" if self.namespace else name

    @property
    def odom(self) -> str:
        """Frame that odometry measures in."""
        return self.topic("odom")

    @property
    def base(self) -> str:
        """Frame that odometry moves: on the floor below a ground robot, in the middle of a flying one."""
        return self.topic("base_footprint" if self.plane == "xy" else "base_link")

    @property
    def scan(self) -> str:
        """Frame of the lidar."""
        return self.topic("base_scan")


def fixed_transforms(frames: Frames, task: NavigationTask) -> list[TransformStamped]:
    """Return the static transforms between base and lidar."""
    if frames.plane == "xz":
        # The lidar turns about its own z, which points along -y of the body: bearings run from x to z.
        scan = _transform(frames.base, frames.scan, (0.0, 0.0, 0.0))
        scan.transform.rotation.x = scan.transform.rotation.w = math.sqrt(0.5)
        return [scan]
    drive = DRIVES[task.robot.body]
    x, y, z = drive.lidar
    return [
        _transform(frames.base, frames.topic("base_link"), (0.0, 0.0, drive.base_height)),
        _transform(frames.topic("base_link"), frames.scan, (x, y, z - drive.base_height)),
    ]


class TransformPublisher:
    """/tf from odometry and /tf_static, or nothing where tf2_msgs is missing."""

    def __init__(self, node: Node, fixed: Sequence[TransformStamped]) -> None:
        self._moving = self._fixed = None
        if TFMessage is None:
            return
        self._moving = node.create_publisher(TFMessage, "/tf", 100)
        self._fixed = node.create_publisher(TFMessage, "/tf_static", LATCHED)
        self._fixed.publish(TFMessage(transforms=list(fixed)))

    def publish(self, odometry: Odometry) -> None:
        """Send the transform that an odometry message tells."""
        if self._moving is None:
            return
        position = odometry.pose.pose.position
        out = _transform(odometry.header.frame_id, odometry.child_frame_id, (position.x, position.y, position.z))
        out.header.stamp = odometry.header.stamp
        out.transform.rotation = odometry.pose.pose.orientation
        self._moving.publish(TFMessage(transforms=[out]))


def _transform(parent: str, child: str, translation: tuple[float, float, float]) -> TransformStamped:
    out = TransformStamped(child_frame_id=child)
    out.header.frame_id = parent
    out.transform.translation.x, out.transform.translation.y, out.transform.translation.z = translation
    return out

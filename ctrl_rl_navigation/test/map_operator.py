"""Operator that sends goals and observes a navigator, and the room that it drives in; shared by tests of the node."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import yaml
from ctrl_rl_core.ros import LATCHED
from ctrl_rl_navigation.cli.simulation import TASK_NAME, task_content
from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from tf2_msgs.msg import TFMessage

from ctrl_rl_core import OccupancyMap
from ctrl_rl_msgs.msg import NavigatorStatus

START = np.array((0.5, 1.0, 2.0))


class Operator:
    """Operator that sends goals and observes the navigator's status."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("operator")
        self.status: list[NavigatorStatus] = []
        self.paths: list[PathMessage] = []
        self.slices: list[OccupancyGrid] = []
        self._tf = self.node.create_publisher(TFMessage, "/tf_static", LATCHED)
        self._goal = self.node.create_publisher(PoseStamped, "goal_pose", 10)
        self.node.create_subscription(NavigatorStatus, "navigator/status", self.status.append, LATCHED)
        self.node.create_subscription(PathMessage, "path", self.paths.append, LATCHED)
        self.node.create_subscription(OccupancyGrid, "navigator/slice", self.slices.append, LATCHED)

    def wait(self, fits: Callable[[], bool], timeout: float = 120.0) -> None:
        deadline = time.monotonic() + timeout
        while not fits():
            rclpy.spin_once(self.node, timeout_sec=0.05)
            assert time.monotonic() < deadline, self.status[-3:]

    def wait_for(self, state: int, words: str = "") -> NavigatorStatus:
        self.status.clear()
        self.wait(lambda: any(each.state == state and words in each.message for each in self.status))
        return self.status[-1]

    def click(self, x: float, y: float, frame: str = "map") -> None:
        self.wait(lambda: self._goal.get_subscription_count() > 0)
        message = PoseStamped()
        message.header.frame_id = frame
        message.pose.position.x, message.pose.position.y = x, y
        message.pose.orientation.w = 0.0  # any heading
        self.status.clear()
        self._goal.publish(message)

    def localise(self) -> None:
        """Publish a transform that puts the origin of odometry at that of the map."""
        message = TransformStamped(child_frame_id="odom")
        message.header.frame_id, message.transform.rotation.w = "map", 1.0
        self._tf.publish(TFMessage(transforms=[message]))

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(60.0)
        future = client.call_async(request)
        self.wait(future.done)
        return future.result()


def write_room(folder: Path, name: str = "room", *walls: tuple[slice, slice]) -> Path:
    """Write a map of a room with a central post and additional walls (rows, columns), and its task; return the map.

    The task is `{TASK_NAME}.yaml` in the same folder.
    """
    cells = np.zeros((44, 64), np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:], cells[17:25, 28:36] = (100,) * 5
    for wall in walls:
        cells[wall] = 100
    file = folder / f"{name}.yaml"
    OccupancyMap(cells, 0.05).save(file)
    if not walls:
        (folder / f"{TASK_NAME}.yaml").write_text(yaml.safe_dump(task_content(file, START), sort_keys=False))
    return file

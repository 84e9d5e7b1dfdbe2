"""What the benchmarks share: a row of figures, the executables of the workspace, the bare echo that is the floor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import rclpy
from ament_index_python.packages import get_package_prefix
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

Row = dict[str, Any]


def row(name: str, value: float, unit: str, against: str, ratio: float | None) -> Row:
    """Return a figure, with what it stands beside and the ratio to that (more than 1 is better, but for latencies)."""
    return {"name": name, "value": value, "unit": unit, "against": against, "ratio": ratio}


def executable(package: str, name: str) -> str:
    """Return the file that `ros2 run` would start, without the command between it and a signal."""
    return str(Path(get_package_prefix(package)) / "lib" / package / name)


def echo(
    taken: type,
    topic: str,
    given: type,
    answer: str,
    qos: tuple[QoSProfile, QoSProfile],
    ns: str = "",
    executor: type[Executor] = SingleThreadedExecutor,
) -> None:
    """Answer each message with an empty one of the same header, until interrupted: the least rclpy node that can."""
    rclpy.init()
    node = Node("echo", namespace=ns or None)
    publisher = node.create_publisher(given, answer, qos[1])
    node.create_subscription(taken, topic, lambda message: publisher.publish(given(header=message.header)), qos[0])
    spinner = executor()
    spinner.add_node(node)
    try:
        while rclpy.ok():
            spinner.spin_once(timeout_sec=0.1)
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()

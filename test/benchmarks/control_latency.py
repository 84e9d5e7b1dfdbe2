"""Control latency: from a scan's publication to the arrival of the command that answers it, against a bare echo.

Both run as processes of their own and answer the same scans in turn; the echo is the least rclpy node that takes a
LaserScan and publishes a TwistStamped.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from _common import Row, echo, executable, row
from ctrl_rl_core.ros import SCAN_PUBLISHER, float32_array, to_stamp
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

from ctrl_rl_core import COMMAND, SENSOR

SCANS = 2000
PAUSE_S = 0.01


class Prober:
    """Publishes scans to one namespace and takes the time of the answers."""

    def __init__(self, node: Node, namespace: str) -> None:
        self._node = node
        self._scan = node.create_publisher(LaserScan, f"/{namespace}/scan", SCAN_PUBLISHER)
        self._odom = node.create_publisher(Odometry, f"/{namespace}/odom", 10)
        self._answered = -1
        self._sent = 0
        node.create_subscription(TwistStamped, f"/{namespace}/cmd_vel", self._on_command, COMMAND)
        deadline = time.monotonic() + 30.0
        while self.ask() is None:
            if time.monotonic() > deadline:
                raise RuntimeError(f"no answer in /{namespace}")

    def ask(self) -> float | None:
        """Return the time to the answer of one scan [s], None after half a second."""
        self._sent += 1
        scan = LaserScan(
            angle_max=2 * np.pi * 359 / 360,
            angle_increment=2 * np.pi / 360,
            range_min=0.12,
            range_max=3.5,
            ranges=float32_array(np.linspace(0.3, 0.6, 360)),
        )
        scan.header.stamp = to_stamp(self._sent)
        self._odom.publish(Odometry())
        time.sleep(0.001)
        begin = time.perf_counter()
        self._scan.publish(scan)
        while self._answered != self._sent:
            rclpy.spin_once(self._node, timeout_sec=0.1)
            if time.perf_counter() - begin > 0.5:
                return None
        return time.perf_counter() - begin

    def _on_command(self, message: TwistStamped) -> None:
        self._answered = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def rows() -> list[Row]:
    """Return medians and 99th percentiles, with the ratio to the echo's."""
    return compare("control", "koopman_lqr_controller", "controller")[0]


def compare(
    name: str, package: str, node_name: str, parameters: tuple[str, ...] = (), scans: int = SCANS
) -> tuple[list[Row], float]:
    """Return the rows of a node's latency, and the ratio of its median to the echo's.

    Args:
        name: Name of the rows.
        package: Package of the node.
        node_name: Executable of the node.
        parameters: Parameters as on the command line.
        scans: Number of scans that each answers.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    given = [word for parameter in parameters for word in ("-p", parameter)]
    processes = [
        subprocess.Popen([sys.executable, str(Path(__file__)), "echo"]),
        subprocess.Popen(
            [executable(package, node_name), "--ros-args", "-r", "__ns:=/controlled", "--log-level", "error", *given],
            stdout=subprocess.DEVNULL,
        ),
    ]
    rclpy.init()
    node = Node("prober")
    try:
        probers = {each: Prober(node, each) for each in ("echo", "controlled")}
        times: dict[str, list[float]] = {each: [] for each in probers}
        for _ in range(scans):
            for each, prober in probers.items():
                answer = prober.ask()
                if answer is not None:
                    times[each].append(1e3 * answer)
                time.sleep(PAUSE_S)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
        for process in processes:
            process.send_signal(signal.SIGINT)
            process.wait(5.0)
    out: list[Row] = []
    mine, floor = (float(np.percentile(times[each], 99)) for each in ("controlled", "echo"))
    out.append(row(f"{name} latency, added to p99", mine - floor, "ms", f"bare rclpy echo, {floor:.3f} ms", None))
    for label, percentile in (("median", 50), ("p99", 99)):
        mine, floor = (float(np.percentile(times[each], percentile)) for each in ("controlled", "echo"))
        against = f"bare rclpy echo of the same scan, {floor:.3f} ms"
        out.append(row(f"{name} latency, {label}", mine, "ms", against, mine / floor))
    return out, float(np.median(times["controlled"]) / np.median(times["echo"]))


if __name__ == "__main__":
    if sys.argv[1:] == ["echo"]:
        echo(LaserScan, "scan", TwistStamped, "cmd_vel", (SENSOR, COMMAND), "echo")
    else:
        print(*rows(), sep="\n")

"""The safety filter: what it adds to a command's latency over a bare echo, and how long a set takes, both at work.

The filter and the echo are processes of their own and answer the same commands in turn, while a lidar at 10 Hz and
odometry at 30 Hz keep the filter solving sets.
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
from ctrl_rl_core.ros import DIAGNOSTICS, SCAN_PUBLISHER, float32_array
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

from ctrl_rl_core import COMMAND

COMMANDS = 2000
_PERIOD_S = 0.015
_SCAN_S, _ODOMETRY_S = 0.1, 1.0 / 30.0
_LONGEST_S = 0.5
_START_S = 60.0
_SETTLED = 100


class Prober:
    """A robot that stands in a corridor, and whoever sends it commands."""

    def __init__(self) -> None:
        self.node = Node("prober")
        make = self.node.create_publisher
        self._scan = make(LaserScan, "/filtered/scan", SCAN_PUBLISHER)
        self._odometry = make(Odometry, "/filtered/odom", 10)
        self._raw = {space: make(TwistStamped, f"/{space}/cmd_vel_raw", COMMAND) for space in ("echo", "filtered")}
        for space in self._raw:
            self.node.create_subscription(TwistStamped, f"/{space}/cmd_vel", self._on_command, COMMAND)
        self.node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 10)
        self._answered, self._sent = -1, 0
        self._scanned = self._moved = 0.0
        self.figures: dict[str, str] = {}

    def ask(self, space: str) -> float | None:
        """Return the time to the answer of one command [s]; None where it does not come."""
        message = TwistStamped()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.twist.angular.z = 0.1
        self._sent = _nanoseconds(message)
        begin = time.perf_counter()
        self._raw[space].publish(message)
        while self._answered != self._sent:
            rclpy.spin_once(self.node, timeout_sec=0.05)
            if time.perf_counter() - begin > _LONGEST_S:
                return None
        return time.perf_counter() - begin

    def pause(self) -> None:
        """Send what sensors send, until the next command is due."""
        deadline = time.perf_counter() + _PERIOD_S
        while (now := time.perf_counter()) < deadline:
            if now - self._moved >= _ODOMETRY_S:
                self._moved = now
                odometry = Odometry()
                odometry.header.stamp, odometry.header.frame_id = self.node.get_clock().now().to_msg(), "odom"
                odometry.pose.pose.orientation.w = 1.0
                self._odometry.publish(odometry)
            if now - self._scanned >= _SCAN_S:
                self._scanned = now
                self._scan.publish(self._corridor())
            rclpy.spin_once(self.node, timeout_sec=0.001)

    def _corridor(self) -> LaserScan:
        bearings = 2.0 * np.pi / 360 * np.arange(360)
        ranges = np.minimum(0.4 / np.maximum(np.abs(np.sin(bearings)), 1e-6), 2.0)
        out = LaserScan(range_min=0.12, range_max=3.5, angle_increment=2.0 * np.pi / 360, angle_max=float(bearings[-1]))
        out.header.stamp = self.node.get_clock().now().to_msg()
        out.ranges = float32_array(ranges)
        return out

    def _on_command(self, message: TwistStamped) -> None:
        if _nanoseconds(message) == self._sent:
            self._answered = self._sent

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/filtered/safety_filter":
                self.figures = {each.key: each.value for each in status.values}


def _nanoseconds(message: TwistStamped) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def rows() -> list[Row]:
    """Return the latencies with their ratios to the echo's, and the times of decisions and sets."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    words = ["--ros-args", "-r", "__ns:=/filtered", "--log-level", "error", "-p", "mover_speed:=0.5"]
    processes = [
        subprocess.Popen([sys.executable, str(Path(__file__)), "echo"]),
        subprocess.Popen([executable("ctrl_rl_safety", "safety_filter"), *words], stdout=subprocess.DEVNULL),
    ]
    rclpy.init()
    prober = Prober()
    times: dict[str, list[float]] = {"echo": [], "filtered": []}
    try:
        deadline = time.monotonic() + _START_S
        while min(map(len, times.values())) < COMMANDS + _SETTLED:
            for space, taken in times.items():
                answer = prober.ask(space)
                if answer is not None:
                    taken.append(1e3 * answer)
                elif not taken and time.monotonic() > deadline:
                    raise RuntimeError(f"no answer in /{space}")
                prober.pause()
    finally:
        prober.node.destroy_node()
        rclpy.try_shutdown()
        for process in processes:
            process.send_signal(signal.SIGINT)
            process.wait(10.0)
    out: list[Row] = []
    for label, percentile in (("median", 50), ("p99", 99)):
        mine, floor = (float(np.percentile(times[each][_SETTLED:], percentile)) for each in ("filtered", "echo"))
        against = f"bare rclpy echo, {floor:.3f} ms"
        out.append(row(f"safety filter latency, added to {label}", mine - floor, "ms", against, mine / floor))
    for name, limit in (("decision p50", 1.0), ("decision p99", 1.5), ("set p50", 100.0), ("set p99", 150.0)):
        value = float(prober.figures[f"{name} [ms]"])
        out.append(row(f"safety filter, {name}", value, "ms", f"limit, {limit:g} ms", value / limit))
    return out


if __name__ == "__main__":
    if sys.argv[1:] == ["echo"]:
        echo(TwistStamped, "cmd_vel_raw", TwistStamped, "cmd_vel", (COMMAND, COMMAND), "echo")
    else:
        print(*rows(), sep="\n")

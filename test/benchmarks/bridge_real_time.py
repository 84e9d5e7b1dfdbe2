"""How much faster than real time the bridge runs: one burger in the corridor, lidar and odometry published over ROS."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import rclpy
from _common import Row, executable, row
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

from ctrl_rl_core import SENSOR, load_navigation_task
from sim_bridge import SimulatedWorld

TASK = "curved_corridor"
TARGET = 20.0
WARM_UP = 2.0
DURATION = 8.0
"""Wall time measured [s]."""


class _Listener(Node):
    """Takes scans and odometry as a controller would, and remembers the newest simulation time [s]."""

    def __init__(self) -> None:
        super().__init__("bridge_benchmark")
        self.newest = 0.0
        self.scans = 0
        self.create_subscription(LaserScan, "scan", self._on_scan, SENSOR)
        self.create_subscription(Odometry, "odom", self._on_odometry, SENSOR)

    def _on_scan(self, _message: LaserScan) -> None:
        self.scans += 1

    def _on_odometry(self, message: Odometry) -> None:
        self.newest = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def rows() -> list[Row]:
    """Measure and return one row per figure; a ratio of 1 or more against the target is good."""
    os.environ.setdefault("ROS_DOMAIN_ID", str(100 + os.getpid() % 100))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    physics = _physics_factor()
    wall, cpu = _bridge_factors()
    against = f"{TARGET:g} times real time"
    return [
        row("bridge, simulation time per CPU time", cpu, "s/s", against, cpu / TARGET),
        row("bridge, simulation time per wall time", wall, "s/s", against, wall / TARGET),
        row("world alone, simulation time per CPU time", physics, "s/s", "bridge, per CPU time", physics / cpu),
    ]


def _physics_factor() -> float:
    """Return simulation time per CPU time of the world without ROS, with as many scans and odometry readings."""
    world = SimulatedWorld(load_navigation_task(TASK), seed=1)
    try:
        simulated, begin = 20.0, time.process_time()
        for step in range(int(simulated * world.options.rate)):
            if step % 8 == 0:
                world.odometry()
                world.episode()
            if step % 48 == 0:
                world.scan()
            world.step()
        return simulated / (time.process_time() - begin)
    finally:
        world.close()


def _bridge_factors() -> tuple[float, float]:
    """Return simulation time per wall time and per CPU time of a bridge process that somebody listens to."""
    program = executable("sim_bridge", "bridge")
    arguments = ["--ros-args", "-p", f"task:={TASK}", "-p", "speed_factor:=0.0"]
    bridge = subprocess.Popen([program, *arguments], stdout=subprocess.DEVNULL)
    rclpy.init()
    listener = _Listener()
    try:
        _spin(listener, WARM_UP)
        while not listener.newest:
            _spin(listener, 0.1)
        begin = (time.monotonic(), _cpu_time(bridge.pid), listener.newest)
        _spin(listener, DURATION)
        end = (time.monotonic(), _cpu_time(bridge.pid), listener.newest)
    finally:
        bridge.send_signal(signal.SIGINT)
        bridge.wait(10.0)
        listener.destroy_node()
        rclpy.try_shutdown()
    simulated = end[2] - begin[2]
    return simulated / (end[0] - begin[0]), simulated / (end[1] - begin[1])


def _spin(node: Node, duration: float) -> None:
    end = time.monotonic() + duration
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.05)


def _cpu_time(pid: int) -> float:
    """Return the CPU time that a process has used [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    print(*rows(), sep="\n")

"""Scans that no lidar should send, to the checks in process and to a real controller."""

from __future__ import annotations

import math
import os
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
from _attack import Attack

LIMITS = (0.22, 2.84)
_SPECIAL = np.array((0.0, np.inf, -np.inf, np.nan, -1.0, 1e-30, 1e30, 0.1199, 3.5001), np.float32)
_NO_KNOWLEDGE = 0.25
"""Share of echoes below the nodes' default at which a robot must stand."""


def geometry(random: np.random.Generator) -> dict[str, Any]:
    """Return the numbers of a scan's geometry: a lidar's, or nonsense."""
    beams = int(random.choice((0, 1, 2, 90, 268, 274, 360, 720, 5000, 25_000)))
    wild = random.random() < 0.4
    nonsense = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e30, 1e-30, 7.0)

    def number(usual: float) -> float:
        return float(random.choice(nonsense)) if wild and random.random() < 0.5 else usual

    increment = random.choice((-1.0, 1.0)) * 2.0 * math.pi / max(beams, 1)
    return {
        "beams": beams,
        "angle_min": number(random.uniform(-math.pi, math.pi)),
        "angle_increment": number(increment),
        "range_min": number(0.12),
        "range_max": number(float(random.choice((3.5, 12.0, 100.0)))),
    }


def content(random: np.random.Generator, beams: int) -> np.ndarray:
    """Return ranges: of a room, with a part of them broken, or of nothing at all."""
    ranges = random.uniform(0.05, 4.0, beams).astype(np.float32)
    kind = random.integers(5)
    if kind == 0:
        return np.full(beams, random.choice(_SPECIAL), np.float32)
    if kind == 1:
        broken = random.random(beams) < random.random()
        ranges[broken] = random.choice(_SPECIAL, int(broken.sum()))
    elif kind == 2:
        begin = int(random.integers(max(beams, 1)))
        ranges = np.roll(np.where(np.arange(beams) < beams // 2, random.choice(_SPECIAL), ranges), begin)
    elif kind == 3:
        ranges = np.frombuffer(random.bytes(4 * beams), np.float32).copy()
    return ranges.astype(np.float32)


def holds_knowledge(ranges: np.ndarray, scan: dict[str, Any]) -> bool:
    """Return whether enough beams have an echo; said once more here, in other words than the node's own."""
    numbers = [scan[name] for name in ("angle_min", "angle_increment", "range_min", "range_max")]
    if not 0 < len(ranges) <= 20_000 or any(math.isnan(number) for number in numbers):
        return False
    low, high = max(float(np.float32(scan["range_min"])), 0.0), float(np.float32(scan["range_max"]))  # as in messages
    echoes = sum(r == -math.inf or (0.0 < r < math.inf and low <= r <= high) for r in ranges.tolist())
    return echoes / len(ranges) >= _NO_KNOWLEDGE


def in_process(random: np.random.Generator, _folder: Path) -> None:
    """Give the checks one scan after the other, and hold what they allow against the promise."""
    from ctrl_rl_core import DriveSafety, ObstacleStop, ScanError, ScanGeometry, ScanHealth

    safety = DriveSafety(ScanHealth(0.3, 2.1, 2), ObstacleStop(0.125, 0.02, 0.5, 0.3), -0.032, 1.0)
    scan, deadline, now = geometry(random), time.monotonic() + 8.0, 0.0
    while time.monotonic() < deadline:
        now += float(random.choice((0.0, 0.2, 3.0)))
        if random.random() < 0.3:
            scan = geometry(random)
        ranges = content(random, scan["beams"])
        stamp = int(random.integers(2**62))
        frame = str(random.choice(("a", "a", "a", "b")))
        safety.update(now, stamp, frame, ranges, ScanGeometry(**scan), tuple(random.normal(0.0, 0.3, 2)))
        command = random.uniform(-1.0, 1.0, 2) * LIMITS
        try:
            allowed, _ = safety.limit(
                command, float(random.normal(0.0, 0.3)), float(random.choice((0.0, 0.5, math.inf)))
            )
        except ScanError:
            continue
        assert np.isfinite(allowed).all(), (scan, command, allowed)
        assert (np.abs(allowed) <= np.abs(command)).all(), (scan, command, allowed)
        assert holds_knowledge(ranges, scan), f"drives at {allowed} on {scan} with {ranges.tolist()[:50]}"


def against_a_controller(random: np.random.Generator, folder: Path) -> None:
    """Send scans to a controller's process and hold each command against the promise."""
    # rclpy reads the domain when it is imported: a process of its own may have its own.
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    import rclpy
    from ament_index_python.packages import get_package_prefix
    from ctrl_rl_core.ros import SCAN_PUBLISHER, float32_array, to_stamp
    from geometry_msgs.msg import TwistStamped
    from nav_msgs.msg import Odometry
    from rclpy.node import Node
    from sensor_msgs.msg import LaserScan

    from ctrl_rl_core import COMMAND

    rclpy.init()
    node = Node("robot")
    commands: list[TwistStamped] = []
    node.create_subscription(TwistStamped, "cmd_vel", commands.append, COMMAND)
    scans, odometry = (
        node.create_publisher(LaserScan, "scan", SCAN_PUBLISHER),
        node.create_publisher(Odometry, "odom", 10),
    )
    policy = str(random.choice(("curved_corridor", "curved_corridor_edmd")))
    program = Path(get_package_prefix("koopman_lqr_controller")) / "lib" / "koopman_lqr_controller" / "controller"
    arguments = ["--ros-args", "-p", f"policy:={policy}", "-p", "scan_timeout:=5.0", "-p", "largest_distance:=0.0"]
    log = folder / "controller.log"
    with log.open("wb") as stream:
        process = subprocess.Popen([program, *arguments], stdout=stream, stderr=stream)
    answers = 0
    try:
        end = time.monotonic() + 30.0
        while not (scans.get_subscription_count() and odometry.get_subscription_count()):
            assert time.monotonic() < end, "the controller does not listen"
            rclpy.spin_once(node, timeout_sec=0.05)
        scan, deadline = geometry(random), time.monotonic() + 10.0
        for number in range(1, 100_000):
            if time.monotonic() > deadline:
                break
            if random.random() < 0.3:
                scan = geometry(random)
            ranges = content(random, scan["beams"])
            message = LaserScan(
                **{
                    name: float(np.clip(value, -3e38, 3e38)) if math.isfinite(value) else value
                    for name, value in scan.items()
                    if name != "beams"
                }
            )
            message.header.stamp = to_stamp(number)
            message.ranges = float32_array(ranges)
            motion = Odometry()
            motion.twist.twist.linear.x = float(random.choice((0.0, 0.2, math.nan, -1e300), p=(0.3, 0.5, 0.1, 0.1)))
            odometry.publish(motion)
            scans.publish(message)
            waited = time.monotonic() + 0.2
            while time.monotonic() < waited and not any(c.header.stamp == message.header.stamp for c in commands):
                rclpy.spin_once(node, timeout_sec=0.02)
            for command in commands:
                v, omega = command.twist.linear.x, command.twist.angular.z
                assert np.isfinite((v, omega)).all(), (scan, v, omega)
                assert abs(v) <= LIMITS[0] + 1e-9, v
                assert abs(omega) <= LIMITS[1] + 1e-9, omega
                if command.header.stamp == message.header.stamp:
                    answers += 1
                    assert (v, omega) == (0.0, 0.0) or holds_knowledge(ranges, as_sent(message)), (scan, v, omega)
            commands.clear()
            assert process.poll() is None, log.read_text()[-2000:]
        assert answers > 0, log.read_text()[-2000:]
        assert "Traceback" not in log.read_text()
        assert "callback failed" not in log.read_text(), log.read_text()[-2000:]
    finally:
        process.terminate()
        process.wait(10.0)
        node.destroy_node()
        rclpy.try_shutdown()


def as_sent(message: Any) -> dict[str, Any]:
    """Return a message's geometry as float32 has it."""
    names = ("angle_min", "angle_increment", "range_min", "range_max")
    return {name: getattr(message, name) for name in names}


ATTACKS = (
    Attack(
        "scans",
        "No scan makes the checks allow a command that is not finite, faster, or without knowledge.",
        in_process,
        limit_s=60.0,
    ),
    Attack(
        "scans-controller",
        "No scan or odometry makes a controller send a command that is not finite, out of limits or blind.",
        against_a_controller,
        limit_s=120.0,
    ),
)

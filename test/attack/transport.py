"""Processes that are killed beside a node that drives: it goes on answering."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from _attack import Attack
from ament_index_python.packages import get_package_prefix

_KILLS = 12
_PATIENCE_S = 30.0
_VICTIM = """
import rclpy
from geometry_msgs.msg import TwistStamped
rclpy.init()
node = rclpy.create_node("victim")
node.create_subscription(TwistStamped, "cmd_vel", lambda _: None, 10)
publisher = node.create_publisher(TwistStamped, "elsewhere", 10)
node.create_timer(0.001, lambda: publisher.publish(TwistStamped()))
rclpy.spin(node)
"""


def run(generator: np.random.Generator, folder: Path) -> None:
    """Kill processes that use shared memory, at drawn moments, beside a watchdog that passes commands on."""
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    import rclpy
    from geometry_msgs.msg import TwistStamped

    path = Path(get_package_prefix("ctrl_rl_core")) / "lib" / "ctrl_rl_core" / "watchdog"
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen([path], stdout=log, stderr=subprocess.STDOUT)
    os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"  # this process is no victim
    rclpy.init()
    victims = dict(os.environ, FASTDDS_BUILTIN_TRANSPORTS="DEFAULT")
    started: list[subprocess.Popen[bytes]] = []
    try:
        node = rclpy.create_node("driver")
        heard: list[float] = []
        node.create_subscription(TwistStamped, "cmd_vel", lambda m: heard.append(m.twist.linear.x), 10)
        commands = node.create_publisher(TwistStamped, "cmd_vel_raw", 1)

        def answers(speed: float) -> None:
            out, deadline = TwistStamped(), time.monotonic() + _PATIENCE_S
            out.twist.linear.x = speed
            while speed not in heard:
                assert time.monotonic() < deadline, f"no answer any more: {(folder / 'log').read_text()}"
                commands.publish(out)
                rclpy.spin_once(node, timeout_sec=0.05)
            heard.clear()

        answers(0.01)
        maps = Path(f"/proc/{process.pid}/maps").read_text(encoding="utf-8")
        assert "/dev/shm/fastrtps_" not in maps, "the watchdog shares memory"
        for number in range(_KILLS):
            victim = subprocess.Popen([sys.executable, "-c", _VICTIM], env=victims, stderr=subprocess.DEVNULL)
            started.append(victim)
            time.sleep(float(generator.uniform(0.5, 1.5)))
            victim.send_signal(signal.SIGKILL)
            victim.wait()
            answers(0.02 + 0.01 * number)
        process.send_signal(signal.SIGINT)
        assert process.wait(_PATIENCE_S) == 0
    finally:
        for each in (process, *started):
            each.kill()
            each.wait()
        rclpy.try_shutdown()


ATTACKS = (
    Attack(
        "transport",
        "A node that drives goes on answering when processes beside it are killed: it shares no memory with them.",
        run,
        limit_s=300.0,
    ),
)

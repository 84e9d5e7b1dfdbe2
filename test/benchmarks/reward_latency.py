"""The reward node under 1 kHz odometry: how many messages it answers, how quickly, against a bare echo.

The same odometry goes first to a bare echo, the least rclpy node that answers an Odometry with a TaskReward (by
`rclpy.spin`, while the node uses the quicker events executor), and then to the node; the recorder writes down when each
message was published.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import rclpy
from _common import Row, echo, executable, row
from ctrl_rl_bringup.runner import answer_latencies, lost_messages, read_sent
from ctrl_rl_core.ros import ODOM_PUBLISHER, to_stamp
from nav_msgs.msg import Odometry
from rclpy.node import Node

from ctrl_rl_core import RESULT, SENSOR
from ctrl_rl_msgs.msg import TaskReward
from ttr_reward_node import solve_task

RATE = 1000.0
SECONDS = {"echo": 20.0, "reward": 60.0}
TASK = "car_ttr"


def rows() -> list[Row]:
    """Return the part answered, and the latency with its ratio to the echo's."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with tempfile.TemporaryDirectory() as folder:
        grid = Path(folder) / "grid.safetensors"
        solve_task(TASK).save(grid)
        node = [executable("ttr_reward_node", "reward"), "--ros-args", "-p", f"grid:={grid}", "--log-level", "error"]
        programs = {"echo": [sys.executable, __file__, "echo"], "reward": node}
        times, answered, lost = {}, {}, 0
        for name, program in programs.items():
            bag = Path(folder) / name
            count = _drive(program, bag, SECONDS[name])
            sent = read_sent(bag)
            times[name] = 1e3 * answer_latencies(sent["/odom"], sent["/reward"])
            answered[name] = len(times[name]) / count
            if name == "reward":
                lost = lost_messages({topic: sent[topic] for topic in ("/odom", "/reward")})
    out: list[Row] = [
        row("reward node, 1 kHz odometry for 60 s, answered", 100 * answered["reward"], "%", "every message", None),
        row("reward node, messages lost", lost, "messages", "the publishers' own count", None),
    ]
    for label, percentile in (("median", 50), ("p99", 99)):
        mine, floor = (float(np.percentile(times[name], percentile)) for name in ("reward", "echo"))
        out.append(row(f"reward latency, {label}", mine, "ms", f"bare rclpy echo, {floor:.3f} ms", mine / floor))
    return out


def _drive(program: list[str], bag: Path, seconds: float) -> int:
    """Run a program and the recorder, publish odometry, and return how many messages were published."""
    recorder = [executable("ctrl_rl_bags", "recorder"), "--ros-args", "-p", f"output:={bag}", "--log-level", "error"]
    with ExitStack() as stack:
        processes = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for command in (program, recorder)]
        stack.callback(_stop, processes)
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        node = Node("prober")
        publisher = node.create_publisher(Odometry, "odom", ODOM_PUBLISHER)
        deadline = time.monotonic() + 60.0
        while publisher.get_subscription_count() < 2 or len(node.get_subscriptions_info_by_topic("/reward")) < 1:
            if time.monotonic() > deadline:
                raise RuntimeError("the node and the recorder do not listen")
            rclpy.spin_once(node, timeout_sec=0.1)
        time.sleep(1.0)  # both ends of every match have seen it
        count = _publish(publisher, seconds)
        time.sleep(1.0)
    return count


def _publish(publisher: rclpy.publisher.Publisher, seconds: float) -> int:
    """Publish positions on a circle at a steady rate."""
    message, begin, count = Odometry(), time.monotonic(), round(RATE * seconds)
    for k in range(count):
        message.header.stamp = to_stamp(k + 1)
        message.pose.pose.position.x, message.pose.pose.position.y = 3.0 * np.cos(0.001 * k), 3.0 * np.sin(0.001 * k)
        publisher.publish(message)
        time.sleep(max(0.0, begin + (k + 1) / RATE - time.monotonic()))
    return count


def _stop(processes: list[subprocess.Popen[bytes]]) -> None:
    for process in processes:
        process.send_signal(signal.SIGINT)
        process.wait(10.0)


if __name__ == "__main__":
    if sys.argv[1:] == ["echo"]:
        echo(Odometry, "odom", TaskReward, "reward", (SENSOR, RESULT))
    else:
        print(*rows(), sep="\n")

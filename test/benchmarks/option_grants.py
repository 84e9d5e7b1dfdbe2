"""Option grants: latency on two processes against a bare topic ping-pong of the same messages, and a burst of requests.

The floor is the least rclpy node that takes an OptionRequest and publishes an OptionGrant. A robot that asks while the
others run waits for the batch window besides: with one robot, as here, nobody is waited for.
"""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import rclpy
from _common import Row, echo, executable, row
from option_coordinator.exchange import AgentState, Request, Status
from option_coordinator.messages import EXCHANGE, request_message, status_message
from option_coordinator.options import Agent
from option_coordinator.policy_file import OptionPolicy
from option_coordinator.training.heads import as_numpy, make_head
from rclpy.experimental import EventsExecutor
from rclpy.node import Node

from ctrl_rl_msgs.msg import AgentStatus, OptionGrant, OptionRequest

ASKED = 500
PAUSE_S = 0.005
BURST = 100
BURSTS = 20
_PATIENCE_S = 60.0
_LIFE = itertools.count(1)


def rows() -> list[Row]:
    """Return medians and 99th percentiles of one robot's grants, and how long a burst takes."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        programs = {"echo": [sys.executable, __file__, "echo"]}
        for name, robots in (("one", 1), ("many", BURST)):
            programs[name] = _coordinator(name, write_policy(Path(folder) / f"{name}.safetensors", robots))
        for program in programs.values():
            stack.callback(_stop, subprocess.Popen(program, stdout=subprocess.DEVNULL))
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        askers = {name: Asker(name, BURST if name == "many" else 1) for name in programs}
        times: dict[str, list[float]] = {name: [] for name in ("echo", "one")}
        for _ in range(ASKED):
            for name, some in times.items():
                some.append(1e3 * askers[name].ask())
                time.sleep(PAUSE_S)
        bursts = [1e3 * askers["many"].ask() for _ in range(BURSTS)]
    return [*_latencies(times), *_burst(bursts, askers["many"].lost)]


def write_policy(path: Path, robots: int) -> Path:
    """Write an untrained mixture policy of many robots, with six options and four numbers each."""
    agents = tuple(Agent(f"r{i}", tuple("abcdef"), 4) for i in range(robots))
    OptionPolicy(agents, "mixture", False, as_numpy(make_head("mixture", agents))).save(path)
    return path


class Asker:
    """One or many robots in one node, that ask at once and take the time until all are answered."""

    def __init__(self, namespace: str, robots: int) -> None:
        self._node = Node("asker", namespace=namespace)
        self._robots = robots
        self._requests = self._node.create_publisher(OptionRequest, "option_requests", EXCHANGE)
        self._statuses = self._node.create_publisher(AgentStatus, "agent_status", EXCHANGE)
        self._node.create_subscription(OptionGrant, "option_grants", self._on_grant, EXCHANGE)
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        self._life, self._number = time.time_ns(), 0
        self._open: set[str] = set()
        self._grants: list[OptionGrant] = []
        self.lost = 0
        self._until_answered()
        self.lost = 0

    def ask(self) -> float:
        """Return how long it takes until all are answered [s]; who is not within a second counts as lost."""
        self._number += 1
        self._grants.clear()
        now = 1e-9 * self._node.get_clock().now().nanoseconds
        robots = range(self._robots)
        self._open = {f"r{i}" for i in robots} if self._node.get_namespace() != "/echo" else {""}
        messages = [request_message(self._request(f"r{i}", now)) for i in robots]
        begin = time.perf_counter()
        for message in messages:
            self._requests.publish(message)
        self._spin(lambda: not self._open, 1.0)
        took = time.perf_counter() - begin
        self.lost += len(self._open)
        for grant in self._grants:
            self._acknowledge(grant)
        return took

    def _request(self, name: str, now: float) -> Request:
        observation, legal = np.zeros(4, np.float32), np.ones(6, bool)
        return Request(now, name, self._life, self._number, 0, observation, legal)

    def _acknowledge(self, grant: OptionGrant) -> None:
        told = {"request_id": grant.request_id, "grant_id": grant.grant_id, "option": grant.option}
        status = Status(grant.agent, self._life, AgentState.RUNNING, grant.coordinator_epoch, **told)
        self._statuses.publish(status_message(status, 0.0))

    def _until_answered(self) -> None:
        deadline = time.monotonic() + _PATIENCE_S
        while self.ask() > 0.9:
            if time.monotonic() > deadline:
                raise RuntimeError(f"no answer in {self._node.get_namespace()}")

    def _on_grant(self, message: OptionGrant) -> None:
        if message.request_id in (self._number, 0) and message.agent in self._open:
            self._open.discard(message.agent)
            self._grants.append(message)

    def _spin(self, until: Callable[[], bool], seconds: float) -> None:
        deadline = time.perf_counter() + seconds
        while not until() and time.perf_counter() < deadline:
            self._executor.spin_once(timeout_sec=0.1)


def _coordinator(name: str, policy: Path) -> list[str]:
    # No robot of this bench beats: nobody is lost meanwhile, and no grant is repeated.
    quiet = {"lost_after": 600.0, "repeat": 10.0, "lease": 0.5, "policy_limit": 1.0}
    settings = [part for key, value in quiet.items() for part in ("-p", f"{key}:={value}")]
    node = executable("option_coordinator", "coordinator")
    return [node, "--ros-args", "-r", f"__ns:=/{name}", "-p", f"policy:={policy}", *settings, "--log-level", "error"]


def _latencies(times: dict[str, list[float]]) -> list[Row]:
    out = []
    for label, percentile in (("median", 50), ("p99", 99)):
        mine, floor = (float(np.percentile(times[name], percentile)) for name in ("one", "echo"))
        out.append(row(f"grant latency, {label}", mine, "ms", f"bare rclpy ping-pong, {floor:.3f} ms", mine / floor))
    return out


def _burst(times: list[float], lost: int) -> list[Row]:
    name, against = f"{BURST} simultaneous requests, all answered", f"{BURSTS} bursts, {lost} requests unanswered"
    return [row(name, float(np.median(times)), "ms", against, None)]


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGINT)
    process.wait(10.0)


if __name__ == "__main__":
    if sys.argv[1:] == ["echo"]:
        echo(OptionRequest, "option_requests", OptionGrant, "option_grants", (EXCHANGE, EXCHANGE), "echo")
    else:
        print(*rows(), sep="\n")

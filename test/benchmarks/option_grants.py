"""Option grants beside a bare ping-pong: for a team that asks at once, and for robots that ask at random.

The floor is the least rclpy node that takes an OptionRequest and publishes an OptionGrant, on the same executor.
"""

from __future__ import annotations

import heapq
import itertools
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import rclpy
from _common import Row, echo, executable, row
from option_coordinator.nodes import EXCHANGE, request_message, status_message
from option_coordinator.protocol import AgentState
from option_coordinator.training import as_numpy, make_head
from rclpy.experimental import EventsExecutor
from rclpy.node import Node

from ctrl_rl_msgs.msg import AgentStatus, OptionGrant, OptionRequest
from option_coordinator import Agent, OptionPolicy, Request, Status

ASKED = {1: 500, 4: 200, 50: 40, 100: 20}
"""How often teams of so many robots ask."""
RATE = 200.0
"""Requests a second of a whole team that asks at random."""
TRAFFIC_S = 5.0
PAUSE_S = 0.005
_PATIENCE_S = 60.0
_LIFE = itertools.count(1)


def rows() -> list[Row]:
    """Return medians and 99th percentiles of the time until all are answered."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    out = []
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        for robots, count in ASKED.items():
            name = f"team_{robots}"
            policy = write_policy(Path(folder) / f"{name}.safetensors", robots)
            with _running(_coordinator(name, policy)), _running([sys.executable, __file__, "echo"]):
                askers = Asker(name, robots), Asker("echo", robots)
                out += _latencies(_title(robots), *_ask_in_turn(*askers, count), sum(asker.lost for asker in askers))
                if robots > 1:
                    title = f"grant latency, {robots} robots that ask at random"
                    out += _latencies(title, *(asker.traffic(TRAFFIC_S) for asker in askers), 0)
                for asker in askers:
                    asker.close()
    return out


def _title(robots: int) -> str:
    return f"grants of {robots} simultaneous requests" if robots > 1 else "grant latency"


def _ask_in_turn(coordinator: Asker, echo: Asker, count: int) -> tuple[list[float], list[float]]:
    """Return times [ms] until the coordinator and the echo have answered."""
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(count):
        for asker, some in zip((coordinator, echo), times, strict=True):
            some.append(1e3 * asker.ask())
            time.sleep(PAUSE_S)
    return times


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
        self._echoed = namespace == "echo"
        self._requests = self._node.create_publisher(OptionRequest, "option_requests", EXCHANGE)
        self._statuses = self._node.create_publisher(AgentStatus, "agent_status", EXCHANGE)
        self._node.create_subscription(OptionGrant, "option_grants", self._on_grant, EXCHANGE)
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        self._life, self._number = time.time_ns(), 0
        self._grants: list[OptionGrant] = []
        self.lost = 0
        self._until_answered()
        self.lost = 0

    def ask(self) -> float:
        """Return how long it takes until all are answered [s]; who is not within a second counts as lost."""
        self._number += 1
        self._grants.clear()
        now = 1e-9 * self._node.get_clock().now().nanoseconds
        messages = [request_message(self._request(f"r{i}", now)) for i in range(self._robots)]
        begin = time.perf_counter()
        for message in messages:
            self._requests.publish(message)
        self._spin(lambda: len(self._grants) == self._robots, 1.0)
        took = time.perf_counter() - begin
        self.lost += self._robots - len(self._grants)
        if not self._echoed:
            for grant in self._grants:
                self._acknowledge(grant)
        return took

    def traffic(self, seconds: float) -> list[float]:
        """Let each robot ask at random times, and return how long each request took [ms]."""
        random = np.random.default_rng(0)
        pause = self._robots / RATE
        due = [(time.perf_counter() + random.uniform(0.0, pause), robot) for robot in range(self._robots)]
        heapq.heapify(due)
        self._number += 1  # one for all: an answer is told by its robot, who has one request open at a time
        numbers = [self._number] * self._robots
        end, times = time.perf_counter() + seconds, []
        while due[0][0] < end:
            begin, robot = due[0]
            self._spin(lambda: False, begin - time.perf_counter())
            self._grants.clear()
            numbers[robot] += 1
            self._number = numbers[robot]
            now = 1e-9 * self._node.get_clock().now().nanoseconds
            message = request_message(self._request(f"r{robot}", now))
            began = time.perf_counter()
            self._requests.publish(message)
            self._spin(lambda: bool(self._grants), 1.0)
            times.append(1e3 * (time.perf_counter() - began))
            if self._grants and not self._echoed:
                self._acknowledge(self._grants[0])
            heapq.heapreplace(due, (time.perf_counter() + random.exponential(pause), robot))
        self._number = max(numbers)
        return times

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()

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
        if self._echoed or message.request_id == self._number:
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


def _latencies(name: str, times: list[float], floor: list[float], lost: int) -> list[Row]:
    out = []
    for label, percentile in (("median", 50), ("p99", 99)):
        mine, bare = (float(np.percentile(some, percentile)) for some in (times, floor))
        against = f"bare rclpy ping-pong of as many, {bare:.3f} ms; {lost} unanswered"
        out.append(row(f"{name}, {label}", mine, "ms", against, mine / bare))
    return out


@contextmanager
def _running(program: list[str]) -> Iterator[None]:
    process = subprocess.Popen(program, stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(10.0)


if __name__ == "__main__":
    if sys.argv[1:] == ["echo"]:
        echo(
            OptionRequest, "option_requests", OptionGrant, "option_grants", (EXCHANGE, EXCHANGE), "echo", EventsExecutor
        )
    else:
        print(*rows(), sep="\n")

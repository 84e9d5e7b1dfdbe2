"""Nodes of the suite as processes, and a node here that hears them and asks them."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import rclpy
from case import ONE_THREAD, BehaviourError, executable_path
from rclpy.duration import Duration

PATIENCE_S = 60.0


class Rig:
    """Runs nodes in a ROS domain of its own unless ROS_DOMAIN_ID says which; a context manager.

    Args:
        folder: Folder that the nodes run in, where their logs go too.
        nodes: Command line of each node by its name.
        topics: Message types by topic that are heard.
        services: Service types by name.

    Attributes:
        node: The node that hears and asks.
        heard: The messages of each topic, in order.
    """

    def __init__(
        self, folder: Path, nodes: Mapping[str, str], topics: Mapping[str, Any], services: Mapping[str, Any]
    ) -> None:
        os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self.heard: dict[str, list[Any]] = {topic: [] for topic in topics}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        rclpy.init()
        with ExitStack() as stack:
            stack.callback(rclpy.try_shutdown)
            self.node = rclpy.create_node("behaviour")
            stack.callback(self.node.destroy_node)
            stack.callback(self._end_processes)
            for topic, kind in topics.items():
                self.node.create_subscription(kind, topic, self.heard[topic].append, 1000)
            self._clients = {name: self.node.create_client(kind, name) for name, kind in services.items()}
            for name, command in nodes.items():
                self._start(folder, name, command)
            self.until(lambda: all(map(self.node.count_publishers, topics)), "all topics")
            self.until(lambda: all(client.service_is_ready() for client in self._clients.values()), "all services")
            if crowded := [topic for topic in topics if self.node.count_publishers(topic) > 1]:
                raise BehaviourError(f"another run is at work in this ROS domain: it publishes {', '.join(crowded)}")
            self._stack = stack.pop_all()

    def publisher(self, kind: Any, topic: str, listeners: int, qos: Any = 1) -> Any:
        """Return a publisher that is heard by at least so many nodes.

        Its history is full with one message: only then Fast DDS asks at once for an acknowledgement, else after 3 s.
        """
        publisher = self.node.create_publisher(kind, topic, qos)
        self.until(lambda: publisher.get_subscription_count() >= listeners, f"{listeners} listeners on {topic}")
        return publisher

    def publish(self, publisher: Any, message: Any) -> None:
        """Publish a message and return when all reliable subscriptions have it."""
        publisher.publish(message)
        if not publisher.wait_for_all_acked(Duration(seconds=PATIENCE_S)):
            raise BehaviourError(f"{publisher.topic_name}: nobody takes a message")

    def until(self, condition: Callable[[], bool], what: str, again: Callable[[], None] = lambda: None) -> None:
        """Hear messages until a condition holds; do something again and again meanwhile.

        Raises:
            BehaviourError: It does not come to hold, or a node has ended.
        """
        end = time.monotonic() + PATIENCE_S
        while not condition():
            ended = [name for name, process in self._processes.items() if process.poll() is not None]
            if ended or time.monotonic() > end:
                raise BehaviourError(f"waited in vain for {what}; nodes that ended: {', '.join(ended) or 'none'}")
            again()
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def call(self, name: str, **fields: Any) -> Any:
        """Call a service and return its answer."""
        client = self._clients[name]
        future = client.call_async(client.srv_type.Request(**fields))
        self.until(future.done, name)
        return future.result()

    def stamped(self, topics: Sequence[str], stamp: Any) -> list[Any]:
        """Return the message with a stamp on each of some topics, as soon as all are there."""

        def latest(topic: str) -> Any:
            return next((each for each in reversed(self.heard[topic]) if each.header.stamp == stamp), None)

        self.until(lambda: all(latest(topic) is not None for topic in topics), f"{', '.join(topics)} at {stamp}")
        return [latest(topic) for topic in topics]

    def forget(self) -> None:
        """Forget what has been heard."""
        for messages in self.heard.values():
            messages.clear()

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _start(self, folder: Path, name: str, command: str) -> None:
        package, executable, *arguments = shlex.split(command)
        with (folder / f"{name}.log").open("wb") as log:
            self._processes[name] = subprocess.Popen(
                [executable_path(package, executable), *arguments],
                cwd=folder,
                env=os.environ | ONE_THREAD,
                stdout=log,
                stderr=log,
            )

    def _end_processes(self) -> None:
        for process in self._processes.values():
            process.send_signal(signal.SIGINT)
        for process in self._processes.values():
            try:
                process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

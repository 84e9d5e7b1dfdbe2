"""Follows the ROS graph and writes what is published to a bag.

`TopicRecorder` subscribes to topics as they appear; `ParameterCollector` asks every node for its parameters.
Both are driven by calling `discover` a few times a second.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from ctrl_rl_core.bag_metadata import Topic
from ctrl_rl_core.bag_writer import BagWriter
from ctrl_rl_core.message_types import UnknownTypeError, message_class, message_definition
from ctrl_rl_core.recorded_qos import request, to_bag

_TAKE_AT_ONCE = 200
"""Messages taken of one topic before the others get their turn."""
_PATIENCE_S = 1.0
"""How long a node has to say its parameters before it is asked again."""


@dataclass
class _Recorded:
    """A topic that is being recorded."""

    type: Any
    subscription: Subscription
    qos: QoSProfile
    publishers: int


class TopicRecorder:
    """Subscribes to every selected topic that has a publisher and writes its bytes untouched.

    Attributes:
        lost: messages that the middleware reports as lost on the way here.
        skipped: why a topic is not recorded, by name.
    """

    def __init__(self, node: Node, writer: BagWriter, selected: Callable[[str], bool], queue_depth: int) -> None:
        self.lost = 0
        self.skipped: dict[str, str] = {}
        self._node = node
        self._writer = writer
        self._selected = selected
        self._queue_depth = queue_depth
        self._recorded: dict[str, _Recorded] = {}

    def discover(self) -> None:
        """Subscribe to new topics; ask for less where a new publisher offers less."""
        for name, types in self._node.get_topic_names_and_types():
            if name in self._recorded:
                self._adapt(name)
            elif name not in self.skipped and self._selected(name):
                self._add(name, types)

    def drain(self) -> None:
        """Write what has arrived and was not yet looked at."""
        for name, recorded in self._recorded.items():
            self._take(name, recorded, limit=self._queue_depth)

    def _add(self, name: str, types: list[str]) -> None:
        publishers = self._node.get_publishers_info_by_topic(name)
        if not publishers:
            return
        type_name = publishers[0].topic_type
        try:
            kind, definition = message_class(type_name), message_definition(type_name)
        except UnknownTypeError as error:
            self.skipped[name] = str(error)
            self._node.get_logger().warning(f"{name} is not recorded: {error}")
            return
        if len(types) > 1:
            self._node.get_logger().warning(f"{name} has types {', '.join(types)}: only {type_name} is recorded")
        type_hash = str(publishers[0].topic_type_hash)
        offered = [publisher.qos_profile for publisher in publishers]
        self._writer.add_topic(
            Topic(
                name,
                type_name,
                definition,
                type_hash if type_hash.startswith("RIHS") else "",
                tuple(to_bag(profile) for profile in offered),
            )
        )
        qos = request(offered, self._queue_depth)
        self._recorded[name] = _Recorded(kind, self._subscribe(name, kind, qos), qos, len(publishers))

    def _adapt(self, name: str) -> None:
        recorded = self._recorded[name]
        count = self._node.count_publishers(name)
        if count == recorded.publishers:
            return
        recorded.publishers = count
        publishers = self._node.get_publishers_info_by_topic(name)
        qos = request([publisher.qos_profile for publisher in publishers], self._queue_depth)
        # Only ever towards weaker requests: a stronger one would bring latched messages a second time.
        if not publishers or not _weaker(qos, recorded.qos):
            return
        self._take(name, recorded, limit=self._queue_depth)
        self._node.destroy_subscription(recorded.subscription)
        recorded.subscription, recorded.qos = self._subscribe(name, recorded.type, qos), qos

    def _subscribe(self, name: str, kind: Any, qos: QoSProfile) -> Subscription:
        def received(data: bytes, info: dict[str, int]) -> None:
            self._write(name, data, info)
            # An executor hands over one message a round; a burst is cheaper to take in one go.
            self._take(name, self._recorded[name], _TAKE_AT_ONCE)

        def lost(event: Any) -> None:
            self.lost += event.total_count_change

        events = SubscriptionEventCallbacks(
            message_lost=lost, incompatible_qos=lambda _event: None, incompatible_type=lambda _event: None
        )
        return self._node.create_subscription(kind, name, received, qos, raw=True, event_callbacks=events)

    def _take(self, name: str, recorded: _Recorded, limit: int) -> None:
        handle = recorded.subscription.handle
        with handle:
            for _ in range(limit):
                taken = handle.take_message(recorded.type, True)
                if taken is None:
                    return
                self._write(name, *taken)

    def _write(self, name: str, data: bytes, info: dict[str, int]) -> None:
        log_time = info["received_timestamp"] or self._node.get_clock().now().nanoseconds
        self._writer.write(
            name, data, log_time, info["source_timestamp"] or log_time, info["publication_sequence_number"] or 0
        )


class ParameterCollector:
    """Asks every node for all of its parameters and keeps them as custom data `parameters.<node>`.

    Best effort: a node that never answers is left out. Later changes are on /parameter_events.
    """

    def __init__(self, node: Node, writer: BagWriter) -> None:
        self._node = node
        self._writer = writer
        self._questions: dict[str, _ParameterQuestion] = {}
        self._known: set[str] = set()

    def discover(self) -> None:
        """Ask nodes that have appeared, as soon as their services are there, until they have answered."""
        present = {
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in self._node.get_node_names_and_namespaces()
            if not name.startswith("_")
        }
        for over in self._questions.keys() & self._known | self._questions.keys() - present:
            self._questions.pop(over).close()
        for name in present - self._known - self._questions.keys():
            self._questions[name] = _ParameterQuestion(self._node, name, partial(self._keep, name))
        for question in self._questions.values():
            question.ask()

    def _keep(self, node: str, values: dict[str, Any]) -> None:
        self._writer.set_custom_data(f"parameters.{node}", json.dumps(values, sort_keys=True, default=str))
        self._known.add(node)


class _ParameterQuestion:
    """One node's parameters, asked for until they are there.

    A node may answer before it has discovered who asks: the answer is lost then, and only asking again helps.
    """

    def __init__(self, node: Node, name: str, keep: Callable[[dict[str, Any]], None]) -> None:
        self._node, self._keep = node, keep
        self._list = node.create_client(ListParameters, f"{name}/list_parameters")
        self._get = node.create_client(GetParameters, f"{name}/get_parameters")
        self._asked = -math.inf

    def ask(self) -> None:
        """Ask, if the services are there and no answer can be expected any more."""
        ready = self._list.service_is_ready() and self._get.service_is_ready()
        if ready and time.monotonic() - self._asked > _PATIENCE_S:
            self._asked = time.monotonic()
            self._call(self._list, ListParameters.Request(), self._listed)

    def close(self) -> None:
        """Ask no more."""
        self._node.destroy_client(self._list)
        self._node.destroy_client(self._get)

    def _listed(self, answer: Any) -> None:
        names = list(answer.result.names)
        self._call(self._get, GetParameters.Request(names=names), partial(self._got, names))

    def _got(self, names: list[str], answer: Any) -> None:
        values = zip(names, answer.values, strict=False)
        self._keep({name: parameter_value_to_python(value) for name, value in values})

    def _call(self, client: Client, question: Any, then: Callable[[Any], None]) -> None:
        def answered(future: Any) -> None:
            if not future.cancelled() and future.exception() is None and future.result() is not None:
                then(future.result())

        client.call_async(question).add_done_callback(answered)


def _weaker(new: QoSProfile, old: QoSProfile) -> bool:
    return (old.reliability == ReliabilityPolicy.RELIABLE != new.reliability) or (
        old.durability == DurabilityPolicy.TRANSIENT_LOCAL != new.durability
    )

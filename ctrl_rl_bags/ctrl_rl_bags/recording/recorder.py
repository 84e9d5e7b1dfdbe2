"""Monitors the ROS graph and writes all published messages to a bag.

`TopicRecorder` subscribes to topics as they appear; `ParameterCollector` requests the parameters of every node. Call
`discover` of both a few times per second.
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

from ctrl_rl_bags.format.metadata import Topic, name_of_other_type
from ctrl_rl_bags.recording.message_types import UnknownTypeError, message_class, message_definition
from ctrl_rl_bags.recording.qos import subscription_qos, to_bag_qos
from ctrl_rl_bags.recording.write_queue import BagQueue

_TAKE_AT_ONCE = 200
"""Maximum number of messages taken from one topic before the next topic's turn."""
_PAUSE_S = 0.02
"""Pause between two rounds [s], to take many messages at once; an executor round costs as much as 20 messages."""
_PATIENCE_S = 1.0
"""Time after which an unanswered parameter request is repeated [s]."""


@dataclass
class _Recorded:
    """A topic being recorded."""

    type_name: str
    type: Any
    bag_name: str
    subscription: Subscription
    qos: QoSProfile
    publishers: int


class TopicRecorder:
    """Subscribes to every selected topic that has a publisher, and writes its bytes unchanged.

    A bag has one type per topic: if all publishers of a topic change its type, recording continues under
    `<topic>/as/<package>/<Name>`.

    Attributes:
        lost: Number of messages that the middleware reports as lost.
        skipped: Reasons for topics not recorded, by name.
        retyped: New names of topics with a changed type.
    """

    def __init__(self, node: Node, queue: BagQueue, selected: Callable[[str], bool], queue_depth: int) -> None:
        self.lost = 0
        self.skipped: dict[str, str] = {}
        self.retyped: dict[str, str] = {}
        self._node = node
        self._queue = queue
        self._selected = selected
        self._queue_depth = queue_depth
        self._recorded: dict[str, _Recorded] = {}
        self._in_bag: dict[str, str] = {}
        self._added: set[str] = set()
        self._refused: set[tuple[str, str]] = set()

    def discover(self) -> None:
        """Subscribe to new topics; relax a QoS request if a new publisher offers less."""
        for name, types in self._node.get_topic_names_and_types():
            if name in self._recorded:
                self._adapt(name, types)
            elif self._selected(name) and not all((name, kind) in self._refused for kind in types):
                self._add(name, self._node.get_publishers_info_by_topic(name))

    def drain(self) -> None:
        """Write all messages that have arrived."""
        for recorded in self._recorded.values():
            self._take(recorded, limit=self._queue_depth)

    def _take_round(self) -> None:
        """Write the messages that have arrived on all topics; pause unless a topic has more."""
        emptied = [self._take(recorded, _TAKE_AT_ONCE) for recorded in self._recorded.values()]
        if all(emptied):
            time.sleep(_PAUSE_S)

    def _add(self, name: str, publishers: list[Any]) -> None:
        """Record a topic with the type of its first publisher."""
        if not publishers:
            return
        type_name = publishers[0].topic_type
        offers = [publisher for publisher in publishers if publisher.topic_type == type_name]
        if (name, type_name) in self._refused:
            return
        try:
            kind, definition = message_class(type_name), message_definition(type_name)
        except UnknownTypeError as error:
            self._refused.add((name, type_name))
            self._skip(name, str(error))
            return
        bag_name, profiles = name, [offer.qos_profile for offer in offers]
        if self._in_bag.setdefault(name, type_name) != type_name:
            bag_name = self.retyped[name] = name_of_other_type(name, type_name)
            self._node.get_logger().warning(
                f"{name} is a {type_name} now, not a {self._in_bag[name]}: recorded as {bag_name}"
            )
        if self._in_bag.setdefault(bag_name, type_name) != type_name:
            self._refused.add((name, type_name))
            self._skip(bag_name, "the bag has another type under that name")
            return
        if bag_name not in self._added:
            self._added.add(bag_name)
            type_hash = str(offers[0].topic_type_hash)
            known_hash = type_hash if type_hash.startswith("RIHS") else ""
            qos_in_bag = tuple(to_bag_qos(profile) for profile in profiles)
            self._queue.add_topic(Topic(bag_name, type_name, definition, known_hash, qos_in_bag))
        self.skipped.pop(name, None)
        qos = subscription_qos(profiles, self._queue_depth)
        subscription = self._subscribe(name, kind, qos)
        self._recorded[name] = _Recorded(type_name, kind, bag_name, subscription, qos, len(publishers))
        self._say_others(name, type_name, publishers)

    def _adapt(self, name: str, types: list[str]) -> None:
        """Adapt to changes in a topic's publishers."""
        recorded = self._recorded[name]
        count = self._node.count_publishers(name)
        if count == recorded.publishers and types == [recorded.type_name]:
            return
        publishers = self._node.get_publishers_info_by_topic(name)
        offers = [publisher for publisher in publishers if publisher.topic_type == recorded.type_name]
        if publishers and not offers:
            # The middleware allows one type per topic and process, so the old subscription must go first.
            self._take(recorded, limit=self._queue_depth)
            self._node.destroy_subscription(recorded.subscription)
            del self._recorded[name]
            self._add(name, publishers)
            return
        if count == recorded.publishers:
            return
        recorded.publishers = count
        self._say_others(name, recorded.type_name, publishers)
        qos = subscription_qos([publisher.qos_profile for publisher in offers], self._queue_depth)
        # Only towards weaker requests, because a stronger one would receive latched messages again.
        if not offers or not _weaker(qos, recorded.qos):
            return
        self._take(recorded, limit=self._queue_depth)
        self._node.destroy_subscription(recorded.subscription)
        recorded.subscription, recorded.qos = self._subscribe(name, recorded.type, qos), qos

    def _say_others(self, name: str, type_name: str, publishers: list[Any]) -> None:
        others = sorted({publisher.topic_type for publisher in publishers} - {type_name})
        if others:
            self._skip(name, f"{', '.join(others)} is not recorded while {type_name} is published too")
        else:
            self.skipped.pop(name, None)

    def _skip(self, name: str, why: str) -> None:
        if self.skipped.get(name) != why:
            self.skipped[name] = why
            self._node.get_logger().warning(f"{name} is not recorded: {why}")

    def _subscribe(self, name: str, kind: Any, qos: QoSProfile) -> Subscription:
        def received(data: bytes, info: dict[str, int]) -> None:
            self._write(self._recorded[name], data, info)
            self._take_round()

        def lost(event: Any) -> None:
            self.lost += event.total_count_change

        events = SubscriptionEventCallbacks(
            message_lost=lost, incompatible_qos=lambda _event: None, incompatible_type=lambda _event: None
        )
        return self._node.create_subscription(kind, name, received, qos, raw=True, event_callbacks=events)

    def _take(self, recorded: _Recorded, limit: int) -> bool:
        """Write up to `limit` pending messages of a topic; return whether none is left."""
        handle = recorded.subscription.handle
        with handle:
            for _ in range(limit):
                taken = handle.take_message(recorded.type, True)
                if taken is None:
                    return True
                self._write(recorded, *taken)
        return False

    def _write(self, recorded: _Recorded, data: bytes, info: dict[str, int]) -> None:
        log_time = info["received_timestamp"] or time.time_ns()
        publish_time, sequence = info["source_timestamp"] or log_time, info["publication_sequence_number"] or 0
        self._queue.write(recorded.bag_name, data, log_time, publish_time, sequence)


class ParameterCollector:
    """Requests the parameters of every node and stores them as custom data `parameters.<node>`.

    A node that never answers is omitted. Later changes are on /parameter_events.
    """

    def __init__(self, node: Node, queue: BagQueue) -> None:
        self._node = node
        self._queue = queue
        self._questions: dict[str, _ParameterQuestion] = {}
        self._known: set[str] = set()

    def discover(self) -> None:
        """Send requests to new nodes once their services are up, and repeat them until answered."""
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
        self._queue.set_custom_data(f"parameters.{node}", json.dumps(values, sort_keys=True, default=str))
        self._known.add(node)


class _ParameterQuestion:
    """Requests the parameters of one node until the answer arrives.

    A node may answer before it has discovered this one; that answer is lost, so the request is repeated.
    """

    def __init__(self, node: Node, name: str, keep: Callable[[dict[str, Any]], None]) -> None:
        self._node, self._keep = node, keep
        self._list = node.create_client(ListParameters, f"{name}/list_parameters")
        self._get = node.create_client(GetParameters, f"{name}/get_parameters")
        self._asked = -math.inf

    def ask(self) -> None:
        """Send the request if the services are up and the last request has timed out."""
        ready = self._list.service_is_ready() and self._get.service_is_ready()
        if ready and time.monotonic() - self._asked > _PATIENCE_S:
            self._asked = time.monotonic()
            self._call(self._list, ListParameters.Request(), self._listed)

    def close(self) -> None:
        """Stop requesting."""
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

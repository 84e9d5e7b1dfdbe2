"""Other publishers of a topic, from the ROS graph; a query takes a fraction of a millisecond."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo


def other_publishers(node: Node, topic: str) -> tuple[str, ...]:
    """Return the full names of the nodes that publish on `topic` besides `node`, in order.

    A second node of the same name counts as another one: two runs of one controller are the likeliest mistake.

    Args:
        node: A node with one publisher on the topic.
        topic: Its resolved name.
    """
    names = sorted(_name(info) for info in node.get_publishers_info_by_topic(topic))
    own = node.get_fully_qualified_name()
    if own in names:
        names.remove(own)
    return tuple(names)


def publishers_of_other_types(node: Node, topic: str, kind: str) -> tuple[str, ...]:
    """Return "/name (pkg/msg/Type)" of each publisher on `topic` whose type is not `kind`: none of them is heard."""
    infos: Sequence[TopicEndpointInfo] = node.get_publishers_info_by_topic(topic)
    return tuple(sorted(f"{_name(info)} ({info.topic_type})" for info in infos if info.topic_type != kind))


def _name(info: TopicEndpointInfo) -> str:
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"

"""Reserves a ROS domain for one run: two runs in one domain hear and spoil each other."""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ctrl_rl_core import CtrlRlError

_VARIABLE = "ROS_DOMAIN_ID"
_OWN_TOPICS = frozenset({"scan", "odom", "cmd_vel", "clock", "episode", "ground_truth", "joint_option_step"})
"""Topics that a run publishes, by the last part of their names."""
_LAST = 101
"""Domains up to this one have ports of their own on every system (ROS documentation, "The ROS_DOMAIN_ID")."""
_HIGHEST = 232
_LISTEN_S = 1.0
_UNNAMED = "a node"


class DomainError(CtrlRlError):
    """Another run uses the ROS domain, or the domain's number is invalid."""


@contextmanager
def own_domain(program: str) -> Iterator[int]:
    """Reserve a ROS domain for one run, and yield its number.

    The domain is ROS_DOMAIN_ID or, if that is not set, the first free one. A domain other than 0 is printed on standard
    error and set for the nodes of the run.

    Args:
        program: Name at the beginning of the report.

    Raises:
        DomainError: Another run uses the domain.
    """
    chosen = os.environ.get(_VARIABLE)
    if chosen:
        with claim(_number(chosen)):
            yield int(chosen)
        return
    with _first_free(program) as number:
        os.environ[_VARIABLE] = str(number)
        try:
            yield number
        finally:
            del os.environ[_VARIABLE]


def stay_local() -> None:
    """Restrict the nodes of this process and its children to this machine, unless ROS's own variable is set."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def keep_domain() -> None:
    """Reserve this process's ROS domain until the process ends.

    Raises:
        DomainError: Another run uses the domain.
    """
    claim(_number(os.environ.get(_VARIABLE) or "0")).detach()


def claim(number: int) -> socket.socket:
    """Return a lock that reserves a domain on this machine as long as it is open.

    Raises:
        DomainError: Another run has it, or nodes in it publish a run's topics.
    """
    keeper = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        # A name without a file: it reaches as far as the loopback does, and ends with the process.
        keeper.bind(f"\0ctrl_rl/domain/{number}")
    except OSError:
        keeper.close()
        raise _taken("another run is", number) from None
    if nodes := _nodes_at_work(number):
        keeper.close()
        raise _taken(f"{', '.join(nodes)} {'is' if len(nodes) == 1 else 'are'}", number)
    return keeper


@contextmanager
def _first_free(program: str) -> Iterator[int]:
    for number in range(_LAST + 1):
        try:
            keeper = claim(number)
        except DomainError as error:
            why = str(error).partition(":")[0]
            continue
        with keeper:
            if number:
                sys.stderr.write(f"{program}: {why}: this run takes {_VARIABLE}={number}\n")
            yield number
        return
    raise DomainError(f"other runs are at work in all ROS domains up to {_LAST}: end one of them")


def _taken(who: str, number: int) -> DomainError:
    return DomainError(f"{who} at work in ROS domain {number}: end that first, or set {_VARIABLE} to another number")


def _nodes_at_work(number: int) -> list[str]:
    """Return the nodes discovered within a second that publish a run's topics."""
    context = Context()
    rclpy.init(context=context, domain_id=number, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node("lookout", context=context, enable_rosout=False, start_parameter_services=False)
        deadline = time.monotonic() + _LISTEN_S
        # A publisher is heard of a little before the name of its node.
        while (not (found := _publishers(node)) or _UNNAMED in found) and time.monotonic() < deadline:
            time.sleep(0.05)
        node.destroy_node()
        return found
    finally:
        context.try_shutdown()


def _publishers(node: Node) -> list[str]:
    topics = [topic for topic, _ in node.get_topic_names_and_types() if topic.rsplit("/", 1)[-1] in _OWN_TOPICS]
    infos = [info for topic in topics for info in node.get_publishers_info_by_topic(topic)]
    return sorted({_name(info) for info in infos})


def _name(publisher: TopicEndpointInfo) -> str:
    if publisher.node_name == "_NODE_NAME_UNKNOWN_":
        return _UNNAMED
    return f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"


def _number(text: str) -> int:
    if not text.isdecimal() or int(text) > _HIGHEST:
        raise DomainError(f"{_VARIABLE}={text}: must be a whole number from 0 to {_HIGHEST}")
    return int(text)

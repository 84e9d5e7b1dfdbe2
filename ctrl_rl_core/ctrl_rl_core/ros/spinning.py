"""Calls the callbacks of the nodes of a process until they end."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from ctrl_rl_core.errors import one_line
from ctrl_rl_core.ros.stop_request import stop_request

if TYPE_CHECKING:
    from ctrl_rl_core.ros.node import SuiteNode

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # rclpy before 7.1.4
    EventsExecutor = None

_POLL_S = 0.1
_BREATH_S = 0.001
"""Pause after an error outside of all callbacks [s], so that a repeated error does not saturate the CPU."""
_SWITCH_S = 0.0005
"""Time after which a thread hands on Python's lock [s]: 5 ms by default, as long as several decisions of a filter."""


def spin(nodes: list[SuiteNode]) -> None:
    """Run the nodes' callbacks until a signal or the middleware ends them.

    Nodes that the events executor does not support have a thread of their own. Where one of these fails, only that one
    ends and leaves the list: a full disk ends a recorder, and must not end the filter beside it.

    Raises:
        Exception: The error that ended a node.
    """
    quick, others = [node for node in nodes if node.QUICK], [node for node in nodes if not node.QUICK]
    if not quick or not others:
        _serve(nodes)
        return
    over, failures = threading.Event(), list[Exception]()
    apart = threading.Thread(target=_serve_apart, args=(others, nodes, over, failures), name="other nodes")
    sys.setswitchinterval(_SWITCH_S)
    apart.start()
    try:
        _serve(quick)
    finally:
        over.set()
        apart.join()
    if failures:
        raise failures[0]


def finish(node: SuiteNode) -> None:
    """Let a node finish its work while its publishers still work."""
    node.stop()
    for server in node.goal_servers:
        server.destroy()


def _serve(nodes: list[SuiteNode]) -> None:
    """Run callbacks in the main thread; the first node that fails ends all, and so stops the robot."""
    executor = _executor(nodes)
    try:
        while not stop_request.asked and rclpy.ok():
            _spin_once(executor, nodes, lambda: stop_request.asked)
            for node in nodes:
                if node.faults.ended_by is not None:
                    raise node.faults.ended_by
            if stop_request.suspended:
                _suspend(nodes)
    finally:
        executor.shutdown()  # before its context is destroyed, or its finaliser would complain


def _serve_apart(
    nodes: list[SuiteNode], all_nodes: list[SuiteNode], over: threading.Event, failures: list[Exception]
) -> None:
    executor = _executor(nodes)
    try:
        while nodes and not over.is_set() and rclpy.ok():
            _spin_once(executor, nodes, over.is_set)
            for node in [each for each in nodes if each.faults.ended_by is not None]:
                error = node.faults.ended_by
                assert error is not None
                failures.append(error)
                node.get_logger().error(f"ends, and the other nodes go on: {one_line(error)}")
                nodes.remove(node)
                all_nodes.remove(node)
                executor.remove_node(node)
                finish(node)
                node.destroy_node()
    except ExternalShutdownException:
        pass
    finally:
        executor.shutdown()


def _executor(nodes: list[SuiteNode]) -> Any:
    quick = nodes[0].QUICK and EventsExecutor is not None
    if nodes[0].QUICK and not quick:
        nodes[0].get_logger().info(
            "this rclpy has no EventsExecutor (7.1.4 has): the usual executor takes twice the time and processor"
        )
    executor = EventsExecutor() if quick else SingleThreadedExecutor()
    for node in nodes:
        node.executor_name = type(executor).__name__
        executor.add_node(node)
    return executor


def _spin_once(executor: Any, nodes: list[SuiteNode], ended: Callable[[], bool]) -> None:
    try:
        executor.spin_once(timeout_sec=_POLL_S)
    except ExternalShutdownException:
        raise
    except Exception as error:  # an unreadable message, or an answer that cannot be sent
        if ended():
            return
        for node in nodes:  # the executor does not say whose
            node.faults.note("executor", error)
        time.sleep(_BREATH_S)


def _suspend(nodes: list[SuiteNode]) -> None:
    """Suspend the process after stopping the robot, since a suspended process cannot stop it."""
    stop_request.suspended = False
    for node in nodes:
        node.on_suspend()
    os.kill(os.getpid(), signal.SIGSTOP)

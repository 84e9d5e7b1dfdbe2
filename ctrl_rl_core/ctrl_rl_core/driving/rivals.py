"""Another node that commands the robot on the same topic: it would be driven round the checks of one of them."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped

from ctrl_rl_core.ros.node import SuiteNode

_OWN_IN_FLIGHT = 50
_DEPTH = 10
_UNNAMED_S = 1.0
"""Time for which a foreign command stops the robot whose publisher is not known, yet or any more [s]."""
_Key = tuple[int, int, float, float, float, float, float, float]


class Rivals:
    """Hears what goes to a robot, and tells commands of other nodes from those of its own.

    A publisher that is silent, such as a watchdog that was killed a moment ago, is no rival. One that has sent a
    command stays one until it has gone. A zero counts, too: of two watchdogs on one robot, the one behind a filter that
    holds the robot sends zeros, and the other must not drive round it.

    Args:
        node: Node that publishes commands.
        kind: Type of its messages, TwistStamped or Twist.
        topic: Topic of its commands, remapped names resolved by ROS.
        on_rival: Function that is called when another node begins to send commands; it must stop the robot.
    """

    def __init__(self, node: SuiteNode, kind: Any, topic: str, on_rival: Callable[[], None]) -> None:
        self._node, self._on_rival = node, on_rival
        self._own: deque[_Key] = deque(maxlen=_OWN_IN_FLIGHT)
        self._heard_at: float | None = None
        self._topic = node.create_subscription(kind, topic, self._hear, _DEPTH).topic_name

    def sent(self, message: TwistStamped | Twist) -> None:
        """Note a command of this node, before anything else is handled."""
        self._own.append(_key(message))

    def fault(self) -> str:
        """Return who else commands the robot; empty where nobody does."""
        if self._heard_at is None:
            return ""
        names = self._node.other_publishers(self._topic)
        if not names and time.monotonic() - self._heard_at > _UNNAMED_S:
            self._heard_at = None
            return ""
        return f"{', '.join(names) or 'another node'} publishes on {self._topic} too: end one of both, or remap it"

    def _hear(self, message: TwistStamped | Twist) -> None:
        key = _key(message)
        if key in self._own:
            self._own.remove(key)
            return
        begins, self._heard_at = self._heard_at is None, time.monotonic()
        if begins:
            self._on_rival()


def _key(message: TwistStamped | Twist) -> _Key:
    """Return stamp and components of a command."""
    stamped = isinstance(message, TwistStamped)
    twist, stamp = (message.twist, message.header.stamp) if stamped else (message, None)
    linear, angular = twist.linear, twist.angular
    when = (0, 0) if stamp is None else (stamp.sec, stamp.nanosec)
    return (*when, linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)

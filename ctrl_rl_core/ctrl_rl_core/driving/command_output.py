"""Outputs for a node's commands: cmd_vel for a wheeled robot, rotor_thrusts for a planar quadrotor.

A rival is another node that commands the robot on the same topic, and so bypasses this node's checks.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time as Stamp
from geometry_msgs.msg import Twist, TwistStamped
from numpy.typing import ArrayLike, NDArray
from rclpy.node import Node
from std_msgs.msg import Header

from ctrl_rl_core.ros.node import COMMAND, SuiteNode
from ctrl_rl_msgs.msg import RotorThrusts

Array = NDArray[np.float64]

_OWN_IN_FLIGHT = 50
_DEPTH = 10
_UNNAMED_S = 1.0
"""Time for which a foreign command from an unidentified publisher stops the robot [s]."""
_Key = tuple[int, int, float, float, float, float, float, float]


class Rivals:
    """Monitors the command topic for commands from other nodes.

    A silent publisher, such as a watchdog killed a moment ago, is not a rival. A publisher that has sent a command
    remains a rival until it disappears. Zero commands count too: if two watchdogs share a robot and one sits behind a
    filter that stops it, that watchdog sends zeros, and the other must not bypass it.

    Args:
        node: Node that publishes commands.
        kind: Message type, TwistStamped or Twist.
        topic: Command topic, with ROS remappings resolved.
        on_rival: Called when another node starts sending commands; must stop the robot.
    """

    def __init__(self, node: SuiteNode, kind: Any, topic: str, on_rival: Callable[[], None]) -> None:
        self._node, self._on_rival = node, on_rival
        self._own: deque[_Key] = deque(maxlen=_OWN_IN_FLIGHT)
        self._heard_at: float | None = None
        self._topic = node.create_subscription(kind, topic, self._hear, _DEPTH).topic_name

    def sent(self, message: TwistStamped | Twist) -> None:
        """Record a command of this node; call it before handling any other message."""
        self._own.append(_key(message))

    def fault(self) -> str:
        """Return the names of other nodes that command the robot; empty if there are none."""
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
    """Return the stamp and components of a command, which identify it."""
    stamped = isinstance(message, TwistStamped)
    twist, stamp = (message.twist, message.header.stamp) if stamped else (message, None)
    linear, angular = twist.linear, twist.angular
    when = (0, 0) if stamp is None else (stamp.sec, stamp.nanosec)
    return (*when, linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)


class CommandOutput(ABC):
    """Publishes commands (2,), reusing one message object because creating one takes as long as a decision.

    Attributes:
        header: Header of the message.
        publisher: Publisher of the topic.
        rest: Idle command (2,).
        units: Units of the two numbers of a command.
    """

    units: tuple[str, str]

    def __init__(self, node: Node, topic: str, message: Any, header: Header, rest: ArrayLike) -> None:
        self.header, self._message = header, message
        self.rest = np.array(rest, np.float64)
        self.rest.flags.writeable = False
        self.publisher = node.create_publisher(type(message), topic, COMMAND)

    @abstractmethod
    def fill(self, first: float, second: float) -> None:
        """Write a command (2,) into the message."""

    def make_rivals(self, node: SuiteNode, on_rival: Callable[[], None]) -> Rivals | None:  # noqa: ARG002
        """Return a monitor for other command publishers, or None if this output has none; see `Rivals`."""
        return None

    def send(self, command: Array, stamp: Stamp) -> Any:
        """Publish a command (2,) and return the message."""
        self.header.stamp = stamp
        self.fill(*command.tolist())
        self.publisher.publish(self._message)
        return self._message


class VelocityOutput(CommandOutput):
    """Publishes speed [m/s] and turn rate [rad/s] on cmd_vel; the idle command is zero."""

    units = ("m/s", "rad/s")

    def __init__(self, node: Node, stamped: bool) -> None:
        message = TwistStamped() if stamped else Twist()
        self._twist = message.twist if stamped else message
        super().__init__(node, "cmd_vel", message, message.header if stamped else Header(), np.zeros(2))

    def make_rivals(self, node: SuiteNode, on_rival: Callable[[], None]) -> Rivals:
        """Return a monitor for other command publishers."""
        return Rivals(node, type(self._message), "cmd_vel", on_rival)

    def fill(self, first: float, second: float) -> None:
        """Write speed and turn rate into the message."""
        self._twist.linear.x, self._twist.angular.z = first, second


class ThrustOutput(CommandOutput):
    """Publishes thrusts T_1 and T_2 [N] on rotor_thrusts; the idle command is hover thrust."""

    units = ("N", "N")

    def __init__(self, node: Node, rest: ArrayLike) -> None:
        self._thrusts = RotorThrusts()
        super().__init__(node, "rotor_thrusts", self._thrusts, self._thrusts.header, rest)

    def fill(self, first: float, second: float) -> None:
        """Write both thrusts into the message."""
        self._thrusts.t1, self._thrusts.t2 = first, second

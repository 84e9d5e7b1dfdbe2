"""Where a node's commands go: cmd_vel of a robot on wheels, or rotor_thrusts of a planar quadrotor."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time as Stamp
from geometry_msgs.msg import Twist, TwistStamped
from numpy.typing import ArrayLike, NDArray
from rclpy.node import Node
from std_msgs.msg import Header

from ctrl_rl_core.driving.rivals import Rivals
from ctrl_rl_core.ros.node import COMMAND, SuiteNode
from ctrl_rl_msgs.msg import RotorThrusts

Array = NDArray[np.float64]


class CommandOutput(ABC):
    """A publisher of commands (2,) with one message object for all, because making one takes as long as a decision.

    Attributes:
        header: Header of the message.
        publisher: Publisher of the topic.
        rest: Command of a robot that has nothing to do (2,).
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
        """Write the two numbers of a command into the message."""

    def make_rivals(self, node: SuiteNode, on_rival: Callable[[], None]) -> Rivals | None:  # noqa: ARG002
        """Return who else commands the robot; None where nobody listens for that. See `Rivals`."""
        return None

    def send(self, command: Array, stamp: Stamp) -> Any:
        """Publish a command (2,), and return its message."""
        self.header.stamp = stamp
        self.fill(*command.tolist())
        self.publisher.publish(self._message)
        return self._message


class VelocityOutput(CommandOutput):
    """Speed [m/s] and turn rate [rad/s] on cmd_vel; the robot rests at zero."""

    units = ("m/s", "rad/s")

    def __init__(self, node: Node, stamped: bool) -> None:
        message = TwistStamped() if stamped else Twist()
        self._twist = message.twist if stamped else message
        super().__init__(node, "cmd_vel", message, message.header if stamped else Header(), np.zeros(2))

    def make_rivals(self, node: SuiteNode, on_rival: Callable[[], None]) -> Rivals:
        """Return who else commands the robot."""
        return Rivals(node, type(self._message), "cmd_vel", on_rival)

    def fill(self, first: float, second: float) -> None:
        """Write speed and turn rate into the message."""
        self._twist.linear.x, self._twist.angular.z = first, second


class ThrustOutput(CommandOutput):
    """Thrusts T_1 and T_2 [N] on rotor_thrusts; the robot rests at those that carry its weight."""

    units = ("N", "N")

    def __init__(self, node: Node, rest: ArrayLike) -> None:
        self._thrusts = RotorThrusts()
        super().__init__(node, "rotor_thrusts", self._thrusts, self._thrusts.header, rest)

    def fill(self, first: float, second: float) -> None:
        """Write both thrusts into the message."""
        self._thrusts.t1, self._thrusts.t2 = first, second

"""Base class of watchdogs: nodes between driver and robot that take over when commands stop coming."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from builtin_interfaces.msg import Time as Stamp
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.time import Time

from ctrl_rl_core.driving.command_output import Rivals
from ctrl_rl_core.driving.watchdog import Watchdog
from ctrl_rl_core.ros.node import COMMAND, Status, SuiteNode, ok, warn
from ctrl_rl_core.ros.parameters import Parameter

_LAST_WORD = Duration(seconds=0.3)
_LATEST_NS = 2**31 * 10**9 - 1
"""Largest representable time stamp [ns]."""


class CommandChannel(Protocol):
    """Defines the commands that a watchdog forwards, and the idle command that it sends when they stop.

    Attributes:
        topic: Topic of the robot's commands; the driver publishes on the same name with the suffix _raw.
        message: Message type of both topics.
        rest: Description of the idle command.
        rate: Rate of idle commands during a silence [Hz].
        repeat_for: Time for which idle commands are sent [s]; 0 for no limit.
        alone: Whether commands of another node on the topic stop the robot.
        hint: Advice shown if the driver publishes another message type.
    """

    topic: str
    message: type[Any]
    rest: str
    rate: float
    repeat_for: float
    alone: bool
    hint: str

    def refuse(self, message: Any) -> str:
        """Return the reason why a command must not reach the robot, or "" if it may."""

    def fill_rest(self, message: Any, silent_for: float | None) -> bool:
        """Write the idle command into a new message.

        Args:
            message: Message to fill, stamped if it has a header.
            silent_for: Age of the last forwarded command [s]; None before the first.

        Returns:
            Whether to send the message.
        """

    def consequence(self, silent_for: float) -> str:
        """Describe what the robot does after a silence of this duration [s]."""


BASE_FRAME = Parameter("base_frame", "base_link", "Frame of the messages before the first command.")


class CommandWatchdog(SuiteNode):
    """Forwards valid commands; sends the idle command when they stop or are invalid.

    Timeouts use wall time, even with use_sim_time. Run the watchdog as a separate process, on the robot's own computer
    if there is one. If the watchdog itself dies, only the robot's base can stop the robot.
    """

    SHARED_MEMORY = False

    def __init__(self, name: str, make_channel: Callable[[Mapping[str, Any]], CommandChannel]) -> None:
        """Create the node.

        Args:
            name: Name of the node.
            make_channel: Creates the channel from the parameter values.
        """
        super().__init__(name)
        self._channel = channel = make_channel(self.settings)
        kind = channel.message
        self._stamped = hasattr(kind(), "header")
        self._frame: str = self.settings["base_frame"]
        timeout = self.settings["timeout"]
        self._watchdog = Watchdog(time.monotonic(), timeout, 1.0 / channel.rate, channel.repeat_for)
        self._counts = {"passed": 0, "refused": 0, f"{channel.rest}s": 0, "stops": 0}
        self._refusal = ""
        self._stamp_lag_ns = 0
        self._said_silent = True
        self._rivals: tuple[str, ...] = ()
        self._senders: tuple[str, ...] = ()
        self._kind = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
        self._output = self.create_publisher(kind, channel.topic, COMMAND)
        self._others = Rivals(self, kind, channel.topic, self._send_rest) if channel.alone else None
        self._input = self.create_subscription(kind, f"{channel.topic}_raw", self._on_command, COMMAND)
        self.create_timer(1.0 / channel.rate, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._send_rest()

    def on_callback_error(self, _error: Exception) -> None:
        """Send the idle command, because a command or a time-out may have been missed."""
        self._send_rest()

    def status(self) -> Status:
        """Report whether commands pass, the age of the last one, and other publishers of the output."""
        age = self._watchdog.silent_for(time.monotonic())
        figures: dict[str, object] = {
            **self._counts,
            "frozen": self._watchdog.overslept,
            "last command [s]": "none yet" if age is None else f"{age:.2f}",
            "timeout [s]": self.settings["timeout"],
        }
        rivals, senders = self._look_around(), self._look_at_senders()
        figures |= {"other publishers": ", ".join(rivals), "senders": ", ".join(senders)}
        problems = [f"{', '.join(rivals)} publishes on {self._output.topic_name} too"] if rivals else []
        if self._refusal:
            problems.append(f"{self._channel.rest} instead of a command: {self._refusal}")
        if age is None:
            problems.append(f"no usable command yet on {self._input.topic_name}{self._wrong_type()}")
        elif self._watchdog.silent:
            problems.append(
                f"no usable command on {self._input.topic_name} for {age:.1f} s: {self._channel.consequence(age)}"
            )
        return warn("; ".join(problems), **figures) if problems else ok("passing commands on", **figures)

    def stop(self) -> None:
        """Send the idle command and wait until it is delivered before closing the publisher."""
        self._send_rest()
        self._output.wait_for_all_acked(_LAST_WORD)

    def on_suspend(self) -> None:
        """Send the idle command, as in `stop`."""
        self.stop()

    def _on_command(self, message: Any) -> None:
        self._refusal = self._channel.refuse(message)
        if self.faults.failing:
            self._refusal = f"a callback failed: {self.faults.last}"
        self._refusal = self._refusal or self._rival()
        if self._refusal:
            self._counts["refused"] += 1
            self.get_logger().warning(
                f"{self._channel.rest} instead of a command: {self._refusal}", throttle_duration_sec=5.0
            )
            self._send_rest()
        elif self._watchdog.passes(time.monotonic()):
            self._counts["passed"] += 1
            if self._stamped:
                self._frame = message.header.frame_id
                self._stamp_lag_ns = self._lag_of(message.header.stamp)
            self._send(message)
        else:
            self._send_rest()
        self._say_what_changed()

    def _tick(self) -> None:
        if self._watchdog.tick(time.monotonic()):
            self._send_rest()
        self._say_what_changed()

    def _say_what_changed(self) -> None:
        if self._watchdog.silent == self._said_silent:
            return
        self._said_silent = self._watchdog.silent
        if not self._said_silent:
            self.get_logger().info("passing commands on")
            return
        self._counts["stops"] += 1
        timeout, topic = self.settings["timeout"], self._input.topic_name
        self.get_logger().warning(f"stopping: no usable command on {topic} for {timeout:g} s")

    def _send_rest(self) -> None:
        """Send the idle command."""
        rest = self._channel.message()
        if self._stamped:
            rest.header.stamp, rest.header.frame_id = self._driver_time(), self._frame
        if self._channel.fill_rest(rest, self._watchdog.silent_for(time.monotonic())):
            self._counts[f"{self._channel.rest}s"] += 1
            self._send(rest)

    def _send(self, message: Any) -> None:
        self._output.publish(message)
        if self._others is not None:
            self._others.sent(message)

    def _lag_of(self, stamp: Stamp) -> int:
        """Return how far a command's stamp lags behind this node's clock [ns]; zero without a stamp."""
        sent = Time.from_msg(stamp).nanoseconds
        return self.get_clock().now().nanoseconds - sent if sent > 0 else 0

    def _driver_time(self) -> Stamp:
        """Return this node's time, converted to the clock of the last command's stamp.

        A driver may stamp a command with the time of its scan, or use another clock. An idle command stamped with this
        node's own clock could be newer than the next command, so time on the topic would appear to jump back.
        """
        now = self.get_clock().now().nanoseconds - self._stamp_lag_ns
        return Time(nanoseconds=min(max(now, 0), _LATEST_NS)).to_msg()

    def _rival(self) -> str:
        return "" if self._others is None else self._others.fault()

    def _look_around(self) -> tuple[str, ...]:
        """Return the other publishers of the output, and log changes."""
        rivals, topic = self.other_publishers(self._output.topic_name), self._channel.topic
        if rivals != self._rivals and rivals:
            self.get_logger().warning(
                f"{', '.join(rivals)} publishes on {self._output.topic_name} too, past this watchdog: end it, or remap "
                f"its {topic} to {topic}_raw"
            )
        self._rivals = rivals
        return rivals

    def _look_at_senders(self) -> tuple[str, ...]:
        """Return the publishers of the input, and log it when there are several: each may move the robot.

        Several publishers are not yet a fault, because a killed process is listed until the middleware notices.
        """
        senders = self.other_publishers(self._input.topic_name)
        if senders != self._senders and len(senders) > 1:
            self.get_logger().warning(f"{', '.join(senders)} all send on {self._input.topic_name}: one should")
        self._senders = senders
        return senders

    def _wrong_type(self) -> str:
        wrong = self.publishers_of_other_types(self._input.topic_name, self._kind)
        return f": {', '.join(wrong)} is ignored{self._channel.hint}" if wrong else ""

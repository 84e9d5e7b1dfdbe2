"""The base of nodes that stand between a driver and its robot, and say what happens when commands stop coming."""

from __future__ import annotations

import time
from abc import abstractmethod
from typing import Any, ClassVar

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
"""The largest time that a stamp can hold."""


class CommandWatchdog(SuiteNode):
    """Passes commands on, and sends the robot's command of rest when they stop coming or make no sense.

    Time is wall time, even with use_sim_time. It must run as a process of its own, on the robot's own computer where
    there is one. If this process itself dies, only the robot's base can stop it.
    """

    SHARED_MEMORY = False
    OUTPUT: ClassVar[str]
    """Topic of the robot's commands; the driver's is the same with _raw."""
    REST: ClassVar[str]
    """Words for the command of rest."""
    BASE_FRAME = Parameter("base_frame", "base_link", "Frame of what is sent before the first command.")

    def __init__(self, name: str) -> None:
        super().__init__(name)
        kind, (rate, repeat_for) = self.message_type(), self.rhythm()
        self._message = kind
        self._stamped = hasattr(kind(), "header")
        self._frame: str = self.settings["base_frame"]
        self._watchdog = Watchdog(time.monotonic(), self.settings["timeout"], 1.0 / rate, repeat_for)
        self._counts = {"passed": 0, "refused": 0, f"{self.REST}s": 0, "stops": 0}
        self._refusal = ""
        self._stamp_lag_ns = 0
        self._said_silent = True
        self._rivals: tuple[str, ...] = ()
        self._kind = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
        self._output = self.create_publisher(kind, self.OUTPUT, COMMAND)
        self._others = self.listen_for_rivals()
        self._input = self.create_subscription(kind, f"{self.OUTPUT}_raw", self._on_command, COMMAND)
        self.create_timer(1.0 / rate, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.send_rest()

    @abstractmethod
    def message_type(self) -> Any:
        """Return the message type of both topics."""

    @abstractmethod
    def rhythm(self) -> tuple[float, float]:
        """Return the rate of rest [Hz] while no commands come, and for how long it is sent [s]; 0 for ever."""

    @abstractmethod
    def refuse(self, message: Any) -> str:
        """Return why a command may not go to the robot, empty where it may."""

    @abstractmethod
    def fill_rest(self, message: Any, silent_for: float | None) -> bool:
        """Write the command of rest into a new message.

        Args:
            message: New message of the output, stamped where it has a header.
            silent_for: Age of the last command that went to the robot [s]; None before the first.

        Returns:
            Whether it is to be sent.
        """

    @abstractmethod
    def consequence(self, silent_for: float) -> str:
        """Return what the robot does without commands, after a silence that has lasted so long [s]."""

    def listen_for_rivals(self) -> Rivals | None:
        """Return who else commands the robot; override it where that is to stop it."""
        return None

    def wrong_type_hint(self) -> str:
        """Return what to do where the driver publishes another type of message."""
        return f": publish {self._kind}"

    def on_callback_error(self, _error: Exception) -> None:
        """Let the robot rest, because a command or a time-out may have been lost."""
        self.send_rest()

    def status(self) -> Status:
        """Return whether commands pass, the age of the last one, and other publishers of the output."""
        age = self._watchdog.silent_for(time.monotonic())
        figures: dict[str, object] = {
            **self._counts,
            "frozen": self._watchdog.overslept,
            "last command [s]": "none yet" if age is None else f"{age:.2f}",
            "timeout [s]": self.settings["timeout"],
        }
        rivals = self._look_around()
        figures["other publishers"] = ", ".join(rivals)
        problems = [f"{', '.join(rivals)} publishes on {self._output.topic_name} too"] if rivals else []
        if self._refusal:
            problems.append(f"{self.REST} instead of a command: {self._refusal}")
        if age is None:
            problems.append(f"no usable command yet on {self._input.topic_name}{self._wrong_type()}")
        elif self._watchdog.silent:
            problems.append(f"no usable command on {self._input.topic_name} for {age:.1f} s: {self.consequence(age)}")
        return warn("; ".join(problems), **figures) if problems else ok("passing commands on", **figures)

    def stop(self) -> None:
        """Leave the robot at rest: that command has arrived before the publisher goes."""
        self.send_rest()
        self._output.wait_for_all_acked(_LAST_WORD)

    def on_suspend(self) -> None:
        """Leave the robot at rest as at the end."""
        self.stop()

    def _on_command(self, message: Any) -> None:
        self._refusal = self.refuse(message)
        if self.faults.failing:
            self._refusal = f"a callback failed: {self.faults.last}"
        self._refusal = self._refusal or self._rival()
        if self._refusal:
            self._counts["refused"] += 1
            self.get_logger().warning(f"{self.REST} instead of a command: {self._refusal}", throttle_duration_sec=5.0)
            self.send_rest()
        elif self._watchdog.passes(time.monotonic()):
            self._counts["passed"] += 1
            if self._stamped:
                self._frame = message.header.frame_id
                self._stamp_lag_ns = self._lag_of(message.header.stamp)
            self._send(message)
        else:
            self.send_rest()
        self._say_what_changed()

    def _tick(self) -> None:
        if self._watchdog.tick(time.monotonic()):
            self.send_rest()
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

    def send_rest(self) -> None:
        """Send the command of rest."""
        rest = self._message()
        if self._stamped:
            rest.header.stamp, rest.header.frame_id = self._driver_time(), self._frame
        if self.fill_rest(rest, self._watchdog.silent_for(time.monotonic())):
            self._counts[f"{self.REST}s"] += 1
            self._send(rest)

    def _send(self, message: Any) -> None:
        self._output.publish(message)
        if self._others is not None:
            self._others.sent(message)

    def _lag_of(self, stamp: Stamp) -> int:
        """Return the lag of a command's stamp behind this node's clock [ns]; zero without a stamp."""
        sent = Time.from_msg(stamp).nanoseconds
        return self.get_clock().now().nanoseconds - sent if sent > 0 else 0

    def _driver_time(self) -> Stamp:
        """Return this node's time on the clock of the last command's stamp.

        A driver may stamp a command with the time of its scan, or by another clock. A command
        of rest stamped with this node's own time would then lie ahead of the command after it, and the topic's clock
        would seem to be set back.
        """
        now = self.get_clock().now().nanoseconds - self._stamp_lag_ns
        return Time(nanoseconds=min(max(now, 0), _LATEST_NS)).to_msg()

    def _rival(self) -> str:
        return "" if self._others is None else self._others.fault()

    def _look_around(self) -> tuple[str, ...]:
        """Return the other publishers of the output; log them when they change."""
        rivals = self.other_publishers(self._output.topic_name)
        if rivals != self._rivals and rivals:
            self.get_logger().warning(
                f"{', '.join(rivals)} publishes on {self._output.topic_name} too, past this watchdog: end it, or remap "
                f"its {self.OUTPUT} to {self.OUTPUT}_raw"
            )
        self._rivals = rivals
        return rivals

    def _wrong_type(self) -> str:
        wrong = self.publishers_of_other_types(self._input.topic_name, self._kind)
        return f": {', '.join(wrong)} is ignored{self.wrong_type_hint()}" if wrong else ""

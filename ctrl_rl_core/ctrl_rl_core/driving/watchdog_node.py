"""The node that stops a robot whose driver died: `ros2 run ctrl_rl_core watchdog`."""

from __future__ import annotations

import math
import sys
import time

from builtin_interfaces.msg import Time as Stamp
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.time import Time

from ctrl_rl_core.driving.watchdog import Watchdog
from ctrl_rl_core.ros.node import COMMAND, Status, SuiteNode, ok, warn
from ctrl_rl_core.ros.parameters import Parameter
from ctrl_rl_core.ros.running import run_node

INPUT, OUTPUT = "cmd_vel_raw", "cmd_vel"
_LAST_ZERO = Duration(seconds=0.3)
_ROUNDING = 1.0 + 1e-6
_LATEST_NS = 2**31 * 10**9 - 1
"""The largest time that a stamp can hold."""


class WatchdogNode(SuiteNode):
    """Passes velocity commands on, and sends zeros to the robot when they stop coming.

    Subscribes to cmd_vel_raw, publishes cmd_vel. Time is wall time, even with use_sim_time. It must run as a
    process of its own, on the robot's own computer where there is one: remap the driver's cmd_vel to cmd_vel_raw. If
    this process itself dies, only the robot's base can stop it.
    """

    SHARED_MEMORY = False
    PARAMETERS = (
        Parameter("timeout", 0.5, "Age of the last command that stops the robot, in wall time [s].", 0.05, 60.0),
        Parameter("zero_rate", 10.0, "Zeros per second while no commands come [Hz].", 1.0, 100.0),
        Parameter(
            "repeat_for",
            5.0,
            "Time that zeros repeat after commands stopped coming [s]; 0.0 for as long as none come.",
            0.0,
            3600.0,
        ),
        Parameter("largest_speed", 0.22, "A faster command is refused, and zero sent instead [m/s].", 0.01, 100.0),
        Parameter("largest_turn_rate", 2.84, "A faster turn is refused, and zero sent instead [rad/s].", 0.01, 100.0),
        Parameter("enable_stamped_cmd_vel", True, "Both topics are TwistStamped (Jazzy), else Twist (Humble)."),
        Parameter("base_frame", "base_link", "Frame of zeros sent before the first command."),
    )

    def __init__(self) -> None:
        super().__init__("watchdog")
        self._stamped: bool = self.settings["enable_stamped_cmd_vel"]
        self._frame: str = self.settings["base_frame"]
        period = 1.0 / self.settings["zero_rate"]
        self._watchdog = Watchdog(time.monotonic(), self.settings["timeout"], period, self.settings["repeat_for"])
        self._counts = {"passed": 0, "refused": 0, "zeros": 0, "stops": 0}
        self._refusal = ""
        self._stamp_lag_ns = 0
        self._said_silent = True
        self._rivals: tuple[str, ...] = ()
        kind = TwistStamped if self._stamped else Twist
        self._kind = f"geometry_msgs/msg/{kind.__name__}"
        self._output = self.create_publisher(kind, OUTPUT, COMMAND)
        self._input = self.create_subscription(kind, INPUT, self._on_command, COMMAND)
        self.create_timer(period, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._send_zero()

    def on_callback_error(self, _error: Exception) -> None:
        """Stop the robot, because a command or a time-out may have been lost."""
        self._send_zero()

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
            problems.append(f"zero instead of a command: {self._refusal}")
        if age is None:
            problems.append(f"no usable command yet on {self._input.topic_name}{self._wrong_type()}")
        elif self._watchdog.silent:
            problems.append(f"no usable command on {self._input.topic_name} for {age:.1f} s: the robot stands")
        return warn("; ".join(problems), **figures) if problems else ok("passing commands on", **figures)

    def stop(self) -> None:
        """Leave the robot standing: the zero velocity has arrived before the publisher goes."""
        self._send_zero()
        self._output.wait_for_all_acked(_LAST_ZERO)

    def _on_command(self, message: TwistStamped | Twist) -> None:
        twist = message.twist if self._stamped else message
        self._refusal = refusal(twist, self.settings["largest_speed"], self.settings["largest_turn_rate"])
        if self.faults.failing:
            self._refusal = f"a callback failed: {self.faults.last}"
        if self._refusal:
            self._counts["refused"] += 1
            self.get_logger().warning(f"zero instead of a command: {self._refusal}", throttle_duration_sec=5.0)
            self._send_zero()
        elif self._watchdog.passes(time.monotonic()):
            self._counts["passed"] += 1
            if self._stamped:
                self._frame = message.header.frame_id
                self._stamp_lag_ns = self._lag_of(message.header.stamp)
            self._output.publish(message)
        else:
            self._send_zero()
        self._say_what_changed()

    def _tick(self) -> None:
        if self._watchdog.tick(time.monotonic()):
            self._send_zero()
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

    def _send_zero(self) -> None:
        self._counts["zeros"] += 1
        zero = TwistStamped() if self._stamped else Twist()
        if self._stamped:
            zero.header.stamp, zero.header.frame_id = self._driver_time(), self._frame
        self._output.publish(zero)

    def _lag_of(self, stamp: Stamp) -> int:
        """Return the lag of a command's stamp behind this node's clock [ns]; zero without a stamp."""
        sent = Time.from_msg(stamp).nanoseconds
        return self.get_clock().now().nanoseconds - sent if sent > 0 else 0

    def _driver_time(self) -> Stamp:
        """Return this node's time on the clock of the last command's stamp.

        A driver may stamp a command with the time of its scan, or by another clock. A zero stamped with this node's
        own time would then lie ahead of the command after it, and the clock of `cmd_vel` would seem to be set back.
        """
        now = self.get_clock().now().nanoseconds - self._stamp_lag_ns
        return Time(nanoseconds=min(max(now, 0), _LATEST_NS)).to_msg()

    def _look_around(self) -> tuple[str, ...]:
        """Return the other publishers of the output; log them when they change."""
        rivals = self.other_publishers(self._output.topic_name)
        if rivals != self._rivals and rivals:
            self.get_logger().warning(
                f"{', '.join(rivals)} publishes on {self._output.topic_name} too, past this watchdog: end it, or remap "
                f"its cmd_vel to {INPUT}"
            )
        self._rivals = rivals
        return rivals

    def _wrong_type(self) -> str:
        wrong = self.publishers_of_other_types(self._input.topic_name, self._kind)
        return f": {', '.join(wrong)} is ignored: set enable_stamped_cmd_vel to match it" if wrong else ""


def refusal(twist: Twist, largest_speed: float, largest_turn_rate: float) -> str:
    """Return why a command may not go to the robot, empty where it may.

    Args:
        twist: Command to check.
        largest_speed: Limit of each linear component [m/s].
        largest_turn_rate: Limit of each angular component [rad/s].
    """
    parts = (
        ("linear", twist.linear, "largest_speed", largest_speed),
        ("angular", twist.angular, "largest_turn_rate", largest_turn_rate),
    )
    for name, vector, parameter, limit in parts:
        for axis in "xyz":
            value = getattr(vector, axis)
            if not math.isfinite(value):
                return f"{name}.{axis} is {value}"
            if abs(value) > limit * _ROUNDING:
                return f"{name}.{axis} is {value:.4g}, more than {parameter} {limit:g}"
    return ""


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_core watchdog`."""
    return run_node(WatchdogNode)


if __name__ == "__main__":
    sys.exit(main())

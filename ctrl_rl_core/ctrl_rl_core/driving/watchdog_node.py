"""Watchdog that stops a robot whose driver has died: `ros2 run ctrl_rl_core watchdog`."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped

from ctrl_rl_core.driving.command_watchdog import BASE_FRAME, CommandWatchdog
from ctrl_rl_core.ros.parameters import ROBOT, Parameter, robot_parameter
from ctrl_rl_core.ros.running import run_node

_ROUNDING = 1.0 + 1e-6


class WatchdogNode(CommandWatchdog):
    """Forwards velocity commands, and sends zeros when they stop coming.

    Subscribes to cmd_vel_raw, publishes cmd_vel: remap the driver's cmd_vel to cmd_vel_raw.
    """

    PARAMETERS = (
        Parameter("timeout", 0.5, "Age of the last command that stops the robot, in wall time [s].", 0.05, 60.0),
        Parameter("zero_rate", 10.0, "Rate of zeros while no commands arrive [Hz].", 1.0, 100.0),
        Parameter(
            "repeat_for",
            5.0,
            "Time for which zeros are repeated after the last command [s]; 0.0 for no limit.",
            0.0,
            3600.0,
        ),
        ROBOT,
        robot_parameter(
            "largest_speed", "speed", "A faster command is refused, and zero sent instead [m/s].", 0.01, 100.0
        ),
        robot_parameter(
            "largest_turn_rate", "turn_rate", "A faster turn is refused, and zero sent instead [rad/s].", 0.01, 100.0
        ),
        Parameter("enable_stamped_cmd_vel", True, "Both topics are TwistStamped (Jazzy), else Twist (Humble)."),
        BASE_FRAME,
    )

    def __init__(self) -> None:
        super().__init__("watchdog", VelocityChannel)


class VelocityChannel:
    """Speeds and turn rates, replaced by zeros during a silence; see `CommandChannel`."""

    topic, rest, alone = "cmd_vel", "zero", True
    hint = ": set enable_stamped_cmd_vel to match it"

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.message: type[TwistStamped | Twist] = TwistStamped if settings["enable_stamped_cmd_vel"] else Twist
        self.rate, self.repeat_for = settings["zero_rate"], settings["repeat_for"]
        self._largest = settings["largest_speed"], settings["largest_turn_rate"]

    def refuse(self, message: TwistStamped | Twist) -> str:  # noqa: D102 - see CommandChannel
        return refusal(message.twist if isinstance(message, TwistStamped) else message, *self._largest)

    def fill_rest(self, _message: TwistStamped | Twist, _silent_for: float | None) -> bool:
        """Keep the message at zero and always send it: the robot may hold a command of a dead watchdog."""
        return True

    def consequence(self, _silent_for: float) -> str:  # noqa: D102 - it is the same after any time
        return "the robot stands"


def refusal(twist: Twist, largest_speed: float, largest_turn_rate: float) -> str:
    """Return the reason why a command must not reach the robot, or "" if it may.

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

"""Watchdog for a planar quadrotor whose pilot node has died: `ros2 run ctrl_rl_core thrust_watchdog`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from ctrl_rl_core.driving.command_watchdog import BASE_FRAME, CommandWatchdog
from ctrl_rl_core.ros.parameters import Parameter
from ctrl_rl_core.ros.running import run_node
from ctrl_rl_msgs.msg import RotorThrusts


class ThrustWatchdogNode(CommandWatchdog):
    """Forwards thrusts; when they stop, sends hover thrust for a limited time, then zero.

    Subscribes to rotor_thrusts_raw, publishes rotor_thrusts: remap the pilot's rotor_thrusts to rotor_thrusts_raw.
    Equal thrusts neither level the robot nor hold its position; they give the next pilot time to take over. A robot
    without a pilot for longer must come down rather than fly off, so its rotors stop. Nothing is sent before the first
    command, so a robot on the ground stays there.
    """

    PARAMETERS = (
        Parameter(
            "timeout", 0.25, "Age of the last thrusts after which rest thrusts are sent, in wall time [s].", 0.02, 60.0
        ),
        Parameter("rest_rate", 20.0, "Rate of rest thrusts while no thrusts arrive [Hz].", 1.0, 200.0),
        Parameter("rest_thrust", 6.13125, "Hover thrust of each rotor pair, half the weight [N].", 0.0, 1000.0),
        Parameter(
            "hover_for",
            2.0,
            "Time after the last thrusts at which the rotors stop [s]; 0.0 for never.",
            0.0,
            3600.0,
        ),
        Parameter("largest_thrust", 15.0, "A stronger thrust is refused, and rest thrusts sent instead [N].", 0.1, 1e4),
        BASE_FRAME,
    )

    def __init__(self) -> None:
        super().__init__("thrust_watchdog", ThrustChannel)


class ThrustChannel:
    """Thrusts of two rotor pairs, replaced by hover thrust during a silence; see `CommandChannel`."""

    topic, rest, alone, message = "rotor_thrusts", "rest thrust", False, RotorThrusts
    hint = ": publish ctrl_rl_msgs/msg/RotorThrusts"
    repeat_for = 0.0

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.rate, self._settings = settings["rest_rate"], settings

    def refuse(self, message: RotorThrusts) -> str:  # noqa: D102 - see CommandChannel
        limit = self._settings["largest_thrust"]
        for name, value in (("t1", message.t1), ("t2", message.t2)):
            if not 0.0 <= value <= limit:  # also rejects NaN
                return f"{name} is {value:.4g} N, not between 0 and largest_thrust {limit:g}"
        return ""

    def fill_rest(self, message: RotorThrusts, silent_for: float | None) -> bool:
        """Write the thrusts of a robot without a pilot; before the first command, send none."""
        if silent_for is None:
            return False
        message.t1 = message.t2 = 0.0 if self._is_over(silent_for) else self._settings["rest_thrust"]
        return True

    def consequence(self, silent_for: float) -> str:  # noqa: D102 - see CommandChannel
        if self._is_over(silent_for):
            return f"the rotors are stopped, since hover_for {self._settings['hover_for']:g} s are over"
        return f"each rotor pair gives {self._settings['rest_thrust']:g} N, which hold neither attitude nor position"

    def _is_over(self, silent_for: float) -> bool:
        return 0.0 < self._settings["hover_for"] <= silent_for


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_core thrust_watchdog`."""
    return run_node(ThrustWatchdogNode)


if __name__ == "__main__":
    sys.exit(main())

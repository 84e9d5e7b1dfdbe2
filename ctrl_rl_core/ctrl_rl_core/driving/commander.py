"""Sends a robot's commands through one publisher; stops the robot on missing or invalid input.

class Echo(SuiteNode):
    PARAMETERS = (*VELOCITY_PARAMETERS, Parameter("scan_timeout", 0.3, "Age of stale odometry [s].", 0.05, 10.0))

    def __init__(self) -> None:
        super().__init__("echo")
        self.robot = Commander(self, needs=("odometry",))
        self.robot.set_limits(*find_robot("turtlebot3_burger").limits)
        self.create_subscription(Odometry, "odom", self._on_odometry, SENSOR)

    def _on_odometry(self, message: Odometry) -> None:
        self.robot.note_input("odometry")
        self.robot.use_frame(message.child_frame_id)
        self.robot.drive(np.array((0.1, 0.0)))
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from builtin_interfaces.msg import Time as Stamp
from numpy.typing import ArrayLike, NDArray
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.time import Time

from ctrl_rl_core.driving.command_output import CommandOutput, VelocityOutput
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.ros.node import Status, SuiteNode, ok, warn
from ctrl_rl_core.ros.parameters import Parameter

VELOCITY_PARAMETERS = (
    Parameter("enable_stamped_cmd_vel", True, "Publish cmd_vel as TwistStamped (Jazzy) instead of Twist (Humble)."),
    Parameter("base_frame", "", "Frame of the commands; empty for the child frame of the odometry."),
    Parameter("managed", False, "Let a lifecycle manager activate the node; the robot moves only while it is active."),
    Parameter("dry_run", False, "Compute and log commands, but send nothing on cmd_vel.", live=True),
    Parameter(
        "wall_timeout",
        5.0,
        "Age of an input in wall time that stops the robot even while the simulated clock stands still [s].",
        0.1,
        3600.0,
    ),
)
_INACTIVE = "the node is inactive: its lifecycle manager must activate it"
_SOME_BASE = "base_link"
"""Frame of the commands until odometry provides one."""
_LAST_WORD = Duration(seconds=0.3)


class VelocityError(CtrlRlError):
    """No velocity may be sent, so the robot must stop; the message gives the reason."""


class Commander:
    """Sends one robot's commands: finite, within limits, and zero when inputs are stale or the node stops.

    With another output, the idle command replaces zero. A dry run does everything except publish. A `DriverNode` makes
    these connections; any other node must call `fail` from `on_callback_error`, `use_parameter` on a parameter change,
    and `stop` from `stop` and `on_suspend`.

    Attributes:
        output: Publisher of the commands.
        low: Lower limits of speed [m/s] and turn rate [rad/s] (2,).
        high: Upper limits of speed [m/s] and turn rate [rad/s] (2,).
        problem: Reason why the robot is stopped; empty while it drives.
        counts: Numbers of commands, of stops, and of checks that found a stale input.
        moving: Whether the last command sent moves the robot.
        timeout: Input age that stops the robot [s].
        limit: Returns the safe part of a command (2,) and the reason for any reduction; raises VelocityError if the
            robot must stop. Replace it to check commands.
        stopping: Returns the stop command (2,); replace it if another command stops the robot more safely.
        on_halt: Called with the command and the reason after each halt.
        on_stale_input: Called with the reason after a stale input has stopped the robot.
    """

    def __init__(
        self, node: SuiteNode, needs: Sequence[str], timeout: str = "scan_timeout", output: CommandOutput | None = None
    ) -> None:
        """Create the publisher; the limits are zero until `set_limits`.

        Args:
            node: Node with `VELOCITY_PARAMETERS`, whose timers and publisher are used.
            needs: Names of the required inputs, as they appear in "no recent NAME".
            timeout: Name of the parameter that holds the input timeout [s].
            output: Publisher of the commands; cmd_vel by default.
        """
        self.node, self.settings = node, node.settings
        self.output = output or VelocityOutput(node, node.settings["enable_stamped_cmd_vel"])
        self.output.header.frame_id = self.settings["base_frame"] or _SOME_BASE
        self.low, self.high = self.output.rest, self.output.rest
        self.timeout = float(self.settings[timeout])
        self.limit: Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], str]] = lambda command: (command, "")
        self.stopping: Callable[[], NDArray[np.float64]] = lambda: self.output.rest
        self.on_halt: Callable[[NDArray[np.float64], str], None] = lambda _command, _problem: None
        self.on_stale_input: Callable[[str], None] = lambda _problem: None
        # Ages are measured on a steady clock, because the system clock may be adjusted while the robot drives. A
        # simulated clock may stand still or run slowly: a longer limit, `wall_timeout`, then applies in wall time.
        simulated = node.get_parameter("use_sim_time").value
        self.clock = node.get_clock() if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._heard: dict[str, Time | None] = dict.fromkeys(needs)
        self._begun = self.clock.now()
        self._wall_timeout: float = self.settings["wall_timeout"] if simulated else math.inf
        self._heard_at: dict[str, float] = {}
        if simulated:
            wall = Clock(clock_type=ClockType.STEADY_TIME)
            node.create_timer(0.25 * self._wall_timeout, self._watch_wall, clock=wall)
        self._rivals: tuple[str, ...] = ()
        self._others = self.output.make_rivals(node, self._on_rival)
        self.counts = {"commands": 0, "stopped": 0, "stale": 0}
        self.moving = False
        self.problem = f"waiting for {' and '.join(needs)}"
        node.create_timer(0.5 * self.timeout, self._watch, clock=self.clock)

    def set_limits(self, low: ArrayLike, high: ArrayLike) -> None:
        """Set the lower and upper limits of speed [m/s] and turn rate [rad/s], (2,) each.

        Raises:
            VelocityError: A limit is not finite, or a lower one exceeds the upper one.
        """
        least, largest = np.array(low, np.float64), np.array(high, np.float64)
        shapes = least.shape == largest.shape == (2,)
        if not (shapes and np.isfinite((least, largest)).all() and (least <= largest).all()):
            raise VelocityError(f"commands from {least} to {largest}: must be two finite numbers each, the least first")
        self.low, self.high = least, largest

    def use_frame(self, name: str) -> None:
        """Send commands in this frame, unless the parameter `base_frame` names another."""
        if name and not self.settings["base_frame"]:
            self.output.header.frame_id = name

    @property
    def frame(self) -> str:
        """Frame of the commands."""
        return str(self.output.header.frame_id)

    def now(self) -> float:
        """Return the current time on the clock used for input ages [s]."""
        return float(self.clock.now().nanoseconds) * 1e-9

    def note_input(self, what: str) -> None:
        """Record that a usable input has just arrived."""
        self._heard[what], self._heard_at[what] = self.clock.now(), time.monotonic()

    def age(self, what: str) -> float:
        """Return the age of an input [s]; infinite before the first message and when it is overdue in wall time."""
        at = self._heard[what]
        if at is None or time.monotonic() - self._heard_at[what] > self._wall_timeout:
            return math.inf
        return self._elapsed(at)

    def stale_input(self) -> str:
        """Return "no recent ..." for the first stale input, or "" if none is stale."""
        return next((f"no recent {what}" for what in self._heard if self.age(what) > self.timeout), "")

    def clip(self, command: NDArray[np.float64]) -> NDArray[np.float64]:
        """Clip a command (2,) to the limits.

        Raises:
            VelocityError: The command is not finite.
        """
        v, omega = command.tolist()
        if not (math.isfinite(v) and math.isfinite(omega)):
            first, second = self.output.units
            raise VelocityError(f"the command is {v} {first}, {omega} {second}: not finite")
        return np.minimum(np.maximum(command, self.low), self.high)

    def drive(self, command: NDArray[np.float64], stamp: Stamp | None = None) -> NDArray[np.float64]:
        """Clip speed [m/s] and turn rate [rad/s] (2,) to the limits, send them, and return the command sent.

        While a callback is failing, the robot is stopped: an input may be missing, or a timer not running.

        Args:
            command: Command (2,); zeros if the robot has nothing to do.
            stamp: Time of the input that the command answers; now by default.

        Raises:
            VelocityError: The command is not finite or not safe; nothing was sent, and the robot must stop.
        """
        if self.node.faults.failing:
            self.halt(f"callback failed: {self.node.faults.last}", stamp)
            return self.output.rest
        if not self.node.is_active:
            self._say(_INACTIVE)
            return self.output.rest
        rival = "" if self.settings["dry_run"] else self.rival()
        if rival and bool((command != self.output.rest).any()):
            self.halt(rival, stamp)
            return self.output.rest
        command, problem = self.limit(self.clip(command))
        if not self.settings["dry_run"]:
            self.counts["commands"] += 1
            self._send(command, stamp)
        self._say(problem)
        return command

    def halt(self, problem: str, stamp: Stamp | None = None) -> None:
        """Send the command from `stopping` (zero velocity by default), and log the reason when it changes.

        Args:
            problem: Reason, for the log and for `diagnostics`.
            stamp: Time of the input that the command answers; now by default.
        """
        command = self.stopping()
        if not self.settings["dry_run"]:
            self._send(command, stamp)
        self._say(problem)
        self.on_halt(command, problem)

    def rival(self) -> str:
        """Return the names of other nodes that command the robot; empty if there are none."""
        return "" if self._others is None else self._others.fault()

    def fail(self) -> None:
        """Stop the robot until every failed callback has succeeded again."""
        self.halt(f"callback failed: {self.node.faults.last}")

    def use_parameter(self, name: str) -> None:
        """Apply a changed parameter; starting a dry run stops the robot, or it would keep its last command."""
        if name == "dry_run" and self.settings["dry_run"] and self.moving:
            self._send(self.output.rest, None)

    def stop(self) -> None:
        """Stop the robot, and wait until the zero velocity is delivered before closing the publisher."""
        if not self.settings["dry_run"]:
            self._send(self.output.rest, None)
            self.output.publisher.wait_for_all_acked(_LAST_WORD)

    def status(self) -> Status:
        """Report whether commands are sent, and the names of other publishers."""
        dry = "dry run, nothing is sent: " if self.settings["dry_run"] else ""
        figures: dict[str, object] = {**self.counts, "other publishers": ", ".join(self._look_for_rivals())}
        if not self.node.is_active:
            return ok(_INACTIVE, **figures)
        if self._rivals:
            figures["problem"] = self.problem
            return warn(f"{dry}{self._rivalry()}", **figures)
        return warn(f"{dry}{self.problem}", **figures) if self.problem else ok(f"{dry}driving", **figures)

    def _watch(self) -> None:
        """Stop the robot when an input times out."""
        if self._elapsed(self._begun) <= self.timeout:
            return  # allow time for the inputs to arrive at startup
        problem = self.stale_input()
        if problem:
            self.counts["stale"] += 1
            self.halt(problem)
            self.on_stale_input(problem)

    def _say(self, problem: str) -> None:
        """Set the reason for stopping, empty for none; changes of its numbers alone are not logged."""
        if problem:
            self.counts["stopped"] += 1
            if _kind(problem) != _kind(self.problem):
                self.node.get_logger().warning(f"stopping: {problem}")
        self.problem = problem

    def _watch_wall(self) -> None:
        """Stop a moving robot when an input is overdue in wall time while the simulated clock stands still."""
        problem = self.stale_input() if self.moving else ""
        if problem:
            self.counts["stale"] += 1
            self.halt(f"{problem} in {self._wall_timeout:g} s of wall time: is the simulation paused?")

    def _on_rival(self) -> None:
        """Stop as soon as another node commands the robot."""
        if self.moving and not self.settings["dry_run"]:
            self.halt(self.rival())

    def _look_for_rivals(self) -> tuple[str, ...]:
        """Return the other publishers of cmd_vel, and log changes."""
        before, self._rivals = self._rivals, self.node.other_publishers(self.output.publisher.topic_name)
        if self._rivals and self._rivals != before:
            self.node.get_logger().warning(self._rivalry())
        return self._rivals

    def _rivalry(self) -> str:
        names, topic = ", ".join(self._rivals), self.output.publisher.topic_name
        return f"{names} publishes on {topic} too: the robot follows the latest command of any"

    def _elapsed(self, then: Time) -> float:
        return float((self.clock.now() - then).nanoseconds) * 1e-9

    def _send(self, command: NDArray[np.float64], stamp: Stamp | None) -> None:
        if not self.node.is_active:
            return
        self.moving = bool((command != self.output.rest).any())
        sent = self.output.send(command, self.node.get_clock().now().to_msg() if stamp is None else stamp)
        if self._others is not None:
            self._others.sent(sent)


def _kind(problem: str) -> str:
    """Return a reason with its numbers removed."""
    return "".join(letter for letter in problem if not letter.isdigit())

"""Node of the flight guard: receives raw thrusts and odometry, publishes guarded thrusts and status."""

from __future__ import annotations

import math
import sys
import time
from collections import Counter, deque
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from ctrl_rl_core.driving import ThrustOutput
from ctrl_rl_core.ros import Status, ok, to_stamp, warn
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType

from ctrl_rl_core import (
    COMMAND,
    RESULT,
    SENSOR,
    OdometryError,
    OdometryReader,
    Parameter,
    ParameterError,
    SuiteNode,
    load_navigation_task,
    read_odometry,
    run_node,
)
from ctrl_rl_msgs.msg import FlightStatus, RotorThrusts
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.flight.flight_guard import FlightGuard, FlightOptions
from ctrl_rl_safety.models.quadrotor_model import quadrotor_of
from ctrl_rl_safety.nodes.flight_parameters import FLIGHT_PARAMETERS
from ctrl_rl_safety.nodes.inputs import AHEAD, age_of

Array = NDArray[np.float64]

INPUT = "rotor_thrusts_raw"
_NAMES = ("waiting", "passed", "corrected", "escaping")
"""Names of the FlightStatus modes in diagnostics."""
WHY = {
    FlightStatus.PASSED: "",
    FlightStatus.CORRECTED: "the raw thrusts leave no escape: the nearest ones that do are sent",
    FlightStatus.ESCAPING: "no thrusts leave an escape: the best one is flown",
}
_LATE = 1.5
"""Time without odometry, in periods, after which the quadrotor continues the escape without it."""
_ALMOST = 0.9
"""Minimum time between two thrusts of that escape, in periods, since timers may fire slightly early."""
_RECENT = 1000
_NONE = np.full(2, math.nan)


class FlightGuardNode(SuiteNode):
    """Passes thrusts to a planar quadrotor as long as an escape from the task's walls and obstacles remains.

    Subscribes to rotor_thrusts_raw and odom, whose frame must be the task's; publishes rotor_thrusts and ~/status.
    Without usable raw thrusts, the quadrotor brakes and hovers; without odometry, it completes the last certified
    escape. After that, and before the first raw thrusts, nothing is sent: remap rotor_thrusts to the input of
    `ctrl_rl_core thrust_watchdog`, which then takes over, also if this process dies.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = FLIGHT_PARAMETERS
    SHARED_MEMORY = False

    def __init__(self) -> None:
        super().__init__("flight_guard")
        value = self.settings
        if value["delay"] > value["period"]:
            raise ParameterError(f"parameter 'delay' is {value['delay']:g} s: at most the period {value['period']:g} s")
        task = load_navigation_task(value["task"])
        model = quadrotor_of(task)
        model = replace(model, mass=value["mass"] or model.mass, disturbance=value["disturbance"])
        world = task.build_world()
        goal = task.goal.region if value["goal"] else None
        options = FlightOptions(value["period"], value["margin"], value["hysteresis"])
        self._guard = FlightGuard(model, (*world.walls, *world.obstacles), options, goal)
        self._hover = np.full(2, 0.5 * model.mass * model.gravity)
        self._guard.warm_up()
        self._simulated = simulated = bool(self.get_parameter("use_sim_time").value)
        self._ages = self.get_clock() if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        # The clock of a fast simulation may arrive after odometry of the same time.
        self._ahead = max(AHEAD, value["odometry_timeout"]) if simulated else AHEAD
        self._read = OdometryReader(("x", "v_x", "z", "v_z", "psi", "omega"))
        self._state, self._stamp, self._heard_at, self._gap, self._frame = _NONE, 0, -math.inf, 0.0, ""
        self._odometry_fault, self._odometry_age, self._answered, self._blind = "", math.inf, 0, False
        self._raw, self._raw_at, self._raw_stamp, self._refusal = _NONE, -math.inf, 0, ""
        self._sent, self._sent_at = _NONE, -math.inf  # infinite while nothing is sent
        self._passed, self._problem = True, "waiting for odometry"
        self._counts: Counter[str] = Counter()
        self._decisions: deque[float] = deque(maxlen=_RECENT)
        self._output = ThrustOutput(self, self._hover)
        self._told = self.create_publisher(FlightStatus, "~/status", RESULT)
        self.create_subscription(Odometry, "odom", self._on_odometry, SENSOR)
        self._input = self.create_subscription(RotorThrusts, INPUT, self._on_raw, COMMAND)
        self.create_timer(0.5 * value["period"], self._fly_on, clock=self._ages)
        self.get_logger().info(f"task '{task.name}': {len(world.walls) + len(world.obstacles)} walls and obstacles")

    def status(self) -> Status:
        """Report the guard's actions and their computation time."""
        figures: dict[str, object] = {name: self._counts[name] for name in (*_NAMES, "changes", "refused")}
        if self._decisions:
            p50, p99 = np.percentile(self._decisions, (50, 99)) * 1e3
            figures |= {"decision p50 [ms]": f"{p50:.2f}", "decision p99 [ms]": f"{p99:.2f}"}
        problems = [self._problem] if self._problem else []
        if rivals := self.other_publishers(self._output.publisher.topic_name):
            problems.append(f"{', '.join(rivals)} publishes on {self._output.publisher.topic_name} too")
        period = self.settings["period"]
        if self._gap > _LATE * period:
            problems.append(f"odometry comes every {self._gap:.3f} s: at least every {period:g} s is needed")
        return warn("; ".join(problems), **figures) if problems else ok("guarding", **figures)

    def _on_odometry(self, message: Odometry) -> None:
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        clock = self.get_clock().now().nanoseconds
        try:
            age = age_of("odometry", stamp, clock, self.settings["odometry_timeout"], self._ahead)
            state = self._read(read_odometry(message))
        except (SafetyError, OdometryError) as error:
            self._odometry_fault = str(error)
            self._counts["refused"] += 1
            return
        if self._stamp and stamp > self._stamp:
            self._gap = 1e-9 * (stamp - self._stamp)
        self._state, self._stamp, self._odometry_age, self._odometry_fault = state, stamp, age, ""
        self._heard_at, self._blind = self._now(), False
        self._frame = message.header.frame_id
        if message.child_frame_id:
            self._output.header.frame_id = message.child_frame_id
        since, period = 1e-9 * (stamp - self._answered), self.settings["period"]
        if since >= period - 0.5 * min(self._gap, period) or since < 0.0:  # or the clock was set back
            self._answer()

    def _on_raw(self, message: RotorThrusts) -> None:
        raw = np.array((message.t1, message.t2))
        if not np.isfinite(raw).all():
            self._refusal = f"raw thrusts of {raw[0]:g} and {raw[1]:g} N"
            self._counts["refused"] += 1
        else:
            stamp = message.header.stamp
            self._refusal, self._raw, self._raw_at = "", raw, self._now()
            self._raw_stamp = stamp.sec * 10**9 + stamp.nanosec
        late = _LATE * self.settings["period"]
        if not self._refusal and not self._odometry_fault and abs(self._now() - self._heard_at) <= late:
            self._answer(within=0.0 <= self._now() - self._sent_at <= late)

    def _answer(self, within: bool = False) -> None:
        """Answer the raw thrusts, using the state from the last odometry.

        Args:
            within: Whether the current period is still running, in which case the last answer may be kept.
        """
        begin, now = time.perf_counter(), self._now()
        silent_for, hover_for = now - self._raw_at, self.settings["hover_for"]
        if silent_for == math.inf:
            self._tell(FlightStatus.WAITING, f"waiting for thrusts on {INPUT}")
            return
        problem = self._refusal
        if abs(silent_for) > self.settings["raw_timeout"]:  # a simulated clock may be set back
            problem = problem or f"no recent thrusts on {self._input.topic_name}"
        if problem and 0.0 < hover_for < silent_for:
            self._sent, self._sent_at = _NONE, -math.inf
            self._tell(FlightStatus.WAITING, f"{problem}: nothing is sent any more")
            return
        held = self._sent if np.isfinite(self._sent).all() else self._hover
        state = self._guard.moved_on(self._state, held, self.settings["delay"])
        if within:
            verdict = self._guard.change(state, self._raw)
        else:
            verdict = self._guard.decide(state, _NONE if problem else self._raw)
        if verdict is None:
            return  # the last thrusts sent are certified until the period ends
        self._answered = self._stamp
        self._decisions.append(time.perf_counter() - begin)
        mode = FlightStatus.PASSED
        if verdict.changed:
            mode = FlightStatus.ESCAPING if verdict.escaping else FlightStatus.CORRECTED
        self._send(verdict.thrusts, now)
        if problem:
            self._tell(FlightStatus.WAITING, f"{problem}: it brakes and hovers", verdict.thrusts, verdict.room)
        else:
            self._tell(mode, WHY[mode], verdict.thrusts, verdict.room)

    def _fly_on(self) -> None:
        """Continue the last certified escape without usable odometry."""
        now, period = self._now(), self.settings["period"]
        waited, unheard = now - self._sent_at, now - self._heard_at
        if not math.isfinite(waited) or 0.0 <= waited < (_ALMOST if self._blind else _LATE) * period:
            return
        if 0.0 <= unheard < period:
            return
        self._blind = True
        why = self._odometry_fault or "no recent odometry"
        thrusts = self._guard.escape_on()
        if thrusts is None:
            self._sent, self._sent_at = _NONE, -math.inf
            self._tell(FlightStatus.WAITING, f"{why}: nothing is sent any more")
        else:
            self._send(thrusts, now)
            self._tell(FlightStatus.WAITING, f"{why}: it flies the last escape", thrusts)

    def _send(self, thrusts: Array, now: float) -> None:
        stamp = self.get_clock().now().to_msg()
        if self._raw_stamp > 0 and math.isfinite(self._raw_at):  # allows computing latencies from a bag
            stamp = to_stamp(max(self._raw_stamp + round(1e9 * (now - self._raw_at)), 0))
        self._output.send(thrusts, stamp)
        self._sent, self._sent_at = thrusts, now

    def _tell(self, mode: int, why: str, sent: Array = _NONE, room: float = math.nan) -> None:
        self._counts[_NAMES[mode]] += 1
        if mode == FlightStatus.WAITING and why != self._problem:
            self.get_logger().warning(why)
        if mode != FlightStatus.WAITING:
            self._counts["changes"] += (mode == FlightStatus.PASSED) != self._passed
            self._passed = mode == FlightStatus.PASSED
        self._problem = why if mode == FlightStatus.WAITING else ""
        out: Any = FlightStatus(mode=mode, why=why, room=room, odometry_age=self._odometry_age)
        out.header.stamp, out.header.frame_id = to_stamp(self._stamp), self._frame
        (out.raw_t1, out.raw_t2), (out.t1, out.t2) = self._raw.tolist(), sent.tolist()
        self._told.publish(out)

    def _now(self) -> float:
        """Return the current time on the clock used for ages [s].

        A simulated clock advances in steps and may arrive after odometry of the same time, so odometry stamps count
        too.
        """
        now = self._ages.now().nanoseconds
        return 1e-9 * float(max(now, self._stamp) if self._simulated else now)


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_safety flight_guard`."""
    return run_node(FlightGuardNode)


if __name__ == "__main__":
    sys.exit(main())

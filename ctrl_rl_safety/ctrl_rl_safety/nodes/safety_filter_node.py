"""Node of the safety filter: receives raw commands, scans and odometry; publishes certified commands and status."""

from __future__ import annotations

import math
import sys
import time
from collections import Counter, deque
from dataclasses import replace
from typing import ClassVar

import numpy as np
from builtin_interfaces.msg import Time as Stamp
from ctrl_rl_core.navigation import TransformError
from ctrl_rl_core.processes import Job, start_job
from ctrl_rl_core.ros import LATCHED, Status, to_stamp, warn
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import LaserScan
from visualization_msgs.msg import Marker

from ctrl_rl_core import COMMAND, RESULT, LidarRobot, Parameter, RobotNode, ScanGeometry, VelocityError, run_node
from ctrl_rl_msgs.msg import SafetyStatus
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.filter.car_filter import make_filter
from ctrl_rl_safety.filter.evidence import beams_of
from ctrl_rl_safety.filter.seen_space import sight_of
from ctrl_rl_safety.filter.verdict import FilterOptions, Mode, Verdict
from ctrl_rl_safety.filter.warming import warm_up
from ctrl_rl_safety.models.car_model import find_vehicle
from ctrl_rl_safety.nodes.inputs import AHEAD, OdometryInput, age_of, beam_times
from ctrl_rl_safety.nodes.map_input import MapInput
from ctrl_rl_safety.nodes.messages import WHY, escape_marker, slice_message
from ctrl_rl_safety.nodes.monitoring import Monitoring
from ctrl_rl_safety.nodes.parameters import FILTER_PARAMETERS
from ctrl_rl_safety.sets.recoverable_set import RecoverableSet

Array = NDArray[np.float64]

INPUT = "cmd_vel_raw"
_JITTER = 1.5
"""Maximum interval between two commands on a busy computer, relative to the requested period."""
_QUICKEST = 0.2
"""Minimum interval between raw commands that are answered at once, as a fraction of the period."""
_PICTURES_S = 0.2
_RECENT = 1000
_STAND = np.zeros(2)


class SafetyFilterNode(RobotNode):
    """Passes velocity commands as long as the robot can still stop without contact, and corrects all others.

    Subscribes to cmd_vel_raw, scan and odom, with use_map also to map and the pose on it; publishes cmd_vel, ~/status,
    ~/set and ~/escape. Without a recent raw command, scan and odometry, the robot stops.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = FILTER_PARAMETERS
    robot: LidarRobot

    def __init__(self) -> None:
        super().__init__("safety_filter")
        value = self.settings
        model = replace(find_vehicle(value["robot"]), missing_rate=value["missing_rate"])
        options = FilterOptions(
            period=_JITTER * value["control_period"],
            mover_speed=value["mover_speed"],
            mover_acceleration=value["mover_acceleration"],
            standing_time=value["standing_time"],
            mover_size=value["mover_size"],
            hysteresis=value["hysteresis"],
            unblock_after=value["unblock_after"],
            evade=value["evade"],
            occluded_movers=value["occluded_movers"],
            unseen=value["unseen"],
        )
        warm_up(model, options)
        self._filter = make_filter(model, options)
        self._monitoring = Monitoring(self._filter, value)
        self.robot = robot = LidarRobot(self, reach=self._filter.reach + abs(value["lidar_x"]))
        robot.set_limits(*model.limits)
        robot.on_scan, robot.on_odometry, robot.on_halt = self._see, self._keep, self._on_halt
        robot.limit, robot.stopping = self._limit, lambda: self._filter.stopping(robot.now())
        robot.fault = lambda: self._monitoring.fault or next((each for each in self._faults_of.values() if each), "")
        # The clock of a fast simulation may arrive after a scan of the same time.
        self._ahead = robot.timeout if self.get_parameter("use_sim_time").value else AHEAD
        self._odometry = OdometryInput(max(model.speed, model.reverse_speed), robot.timeout, self._ahead)
        self._map = MapInput(self, robot.timeout, robot.now) if value["use_map"] else None
        self._faults_of = {"odometry": "", "scan": "", "raw command": ""}
        self._raw, self._raw_at, self._raw_stamp = _STAND, -math.inf, 0
        self._answered_at, self._last_mode = -math.inf, Mode.PASSED
        self._job: Job[RecoverableSet | None] | None = None
        self._solved_for: object = None
        self._counts: Counter[str] = Counter()
        self._decisions: deque[float] = deque(maxlen=_RECENT)
        self._solves: deque[float] = deque(maxlen=_RECENT)
        self._verdict: Verdict | None = None
        self._told = self.create_publisher(SafetyStatus, "~/status", RESULT)
        self._set = self.create_publisher(OccupancyGrid, "~/set", LATCHED)
        self._escape = self.create_publisher(Marker, "~/escape", 1)
        self._stamped: bool = value["enable_stamped_cmd_vel"]
        kind = TwistStamped if self._stamped else Twist
        self._kind = f"geometry_msgs/msg/{kind.__name__}"
        self._timer = self.create_timer(value["control_period"], self._tick, clock=robot.clock)
        self.create_timer(_PICTURES_S, self._show, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._commands = self.create_subscription(kind, INPUT, self._on_raw, COMMAND)

    def _limit(self, command: Array) -> tuple[Array, str]:
        """Return a command (2,), and the reason for stopping if there is no raw command.

        Raises:
            VelocityError: The inputs forbid motion.
        """
        command, problem = self.robot.limit_by_scan(command)
        return command, problem or self._silence()

    def _on_halt(self, command: Array, problem: str) -> None:
        """Record that the robot brakes, and report the reason."""
        self._monitoring.sent(self.robot.now(), command)
        self._counts["waiting"] += 1
        self._tell(command, SafetyStatus.WAITING, problem)

    def _keep(self, message: Odometry, odometry: Array) -> None:
        """Store pose and speeds, and watch the motion; a jump of the frame resets the filter."""
        now, clock = self.robot.now(), self.get_clock().now().nanoseconds
        try:
            jumped = self._odometry.update(message, now, clock)
        except (SafetyError, TransformError) as error:
            self._faults_of["odometry"] = str(error)
            return
        self._faults_of["odometry"] = ""
        if jumped:
            self._monitoring.forget()
        self._monitoring.measure(now, self._odometry.reading(now), odometry)
        if self._map is not None:
            self._map.on_odometry(message, self.robot.frame)

    def _see(self, message: LaserScan, ranges: NDArray[np.float32], scan: ScanGeometry) -> None:
        """Store the echoes, and start solving the set of the last scan unless a solve is running."""
        view = self.robot.safety.view
        if view is None:
            return
        now, clock = self.robot.now(), self.get_clock().now().nanoseconds
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        try:
            age = age_of("scan", stamp, clock, self.robot.timeout, self._ahead)
            fixed = None if self._map is None else self._map.fixed(self._odometry.reading(now).pose)
            lidar_x = self.settings["lidar_x"]
            beams, sight = beams_of(ranges, scan, lidar_x), sight_of(ranges, scan, lidar_x)
            echoes, ends = (
                self._odometry.straightened(
                    each, beam_times(each, scan, message.time_increment, lidar_x, self.robot.timeout), stamp
                )
                for each in (view.points, beams.ends)
            )
            beams, pose = beams._replace(ends=ends), self._odometry.pose_at(stamp)
            self._filter.see(now, pose, echoes, age, fixed, sight, beams)
        except (SafetyError, TransformError) as error:
            self._faults_of["scan"] = str(error)
            return
        self._faults_of["scan"] = ""
        self._monitoring.look(pose, echoes)
        self._solve()

    def status(self) -> Status:
        """Report the filter's actions and their computation time."""
        level, message, figures = super().status()
        figures = {**figures, **{mode.name.lower(): self._counts[mode.name] for mode in Mode}}
        figures |= {"waiting": self._counts["waiting"], "changes": self._counts["changes"]}
        figures |= {"odometry jumps": self._odometry.jumps, "sets solved": self._counts["sets"]}
        if self._map is not None:
            figures["map"] = self._map.problem or "in use"
        for name, times in (("decision", self._decisions), ("set", self._solves)):
            if times:
                p50, p99 = np.percentile(times, (50, 99)) * 1e3
                figures |= {f"{name} p50 [ms]": f"{p50:.2f}", f"{name} p99 [ms]": f"{p99:.2f}"}
        figures |= self._monitoring.figures()
        wrong = self.publishers_of_other_types(self._commands.topic_name, self._kind)
        if wrong:
            return warn(f"{', '.join(wrong)} is ignored: set enable_stamped_cmd_vel to match it", **figures)
        worse = self._monitoring.words()
        return warn(worse, **figures) if worse and not self._monitoring.fault else (level, message, figures)

    def _on_raw(self, message: TwistStamped | Twist) -> None:
        twist = message.twist if isinstance(message, TwistStamped) else message
        raw = np.array((twist.linear.x, twist.angular.z))
        if not np.isfinite(raw).all():
            self._faults_of["raw command"] = f"raw command of {raw[0]} m/s and {raw[1]} rad/s"
            self._tick()
            return
        self._faults_of["raw command"] = ""
        now = self.robot.now()
        self._raw, self._raw_at, self._raw_stamp = raw, now, 0
        if isinstance(message, TwistStamped):
            self._raw_stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        if abs(now - self._answered_at) >= _QUICKEST * self.settings["control_period"]:
            self._answered_at = now
            self._timer.reset()  # the next tick is one period after this answer
            self._tick(now)

    def _silence(self) -> str:
        """Return a message that no raw command arrives; empty otherwise."""
        if abs(self.robot.now() - self._raw_at) <= self.settings["raw_timeout"]:  # a simulated clock may be set back
            return ""
        return f"no recent command on {self._commands.topic_name}"

    def _stamp(self, now: float) -> Stamp | None:
        """Return the raw command's stamp plus the time since then, so that latencies can be computed from a bag."""
        return to_stamp(self._raw_stamp + round(1e9 * (now - self._raw_at))) if self._raw_stamp > 0 else None

    def _tick(self, at: float | None = None) -> None:
        """Answer the current raw command at a time on the clock of ages [s]; now by default."""
        begin, now = time.perf_counter(), self.robot.now() if at is None else at
        self._take_set()
        problem = self.robot.input_fault()
        if not problem and self._filter.obstacles is None:
            problem = "waiting for a scan"
        if problem:
            self.robot.halt(problem)
            return
        raw = _STAND if self._silence() else self._raw
        verdict = self._filter.decide(now, self._odometry.reading(now), raw)
        try:
            sent = self.robot.drive(verdict.command, self._stamp(now))
        except VelocityError as error:
            self.robot.halt(str(error))
            return
        self._monitoring.sent(now, sent)
        self._decisions.append(time.perf_counter() - begin)
        self._verdict = verdict
        self._counts[verdict.mode.name] += 1
        self._counts["changes"] += (verdict.mode is Mode.PASSED) != (self._last_mode is Mode.PASSED)
        self._last_mode = verdict.mode
        self._tell(sent, int(verdict.mode), self._silence() or WHY[verdict.mode], verdict)

    def _tell(self, sent: Array, mode: int, why: str, verdict: Verdict | None = None) -> None:
        why = "; ".join(each for each in (why, self._monitoring.words()) if each)
        out = SafetyStatus(mode=mode, why=why, margin=math.nan, value=math.nan)
        out.header.stamp, out.header.frame_id = self.get_clock().now().to_msg(), self._odometry.frame
        out.raw_speed, out.raw_turn_rate = self._raw.tolist()
        out.speed, out.turn_rate = sent.tolist()
        out.scan_age = self.robot.age("scan")
        if verdict is not None:
            out.margin, out.value = verdict.margin, verdict.value
        self._told.publish(out)

    def _solve(self) -> None:
        """Start solving the set of the last scan in a thread, unless a solve is running."""
        if self._job is None and self._filter.obstacles is not self._solved_for:
            self._solved_for = self._filter.obstacles
            solve, begin = self._filter.solve, time.perf_counter()

            def work(_job: Job[RecoverableSet | None]) -> RecoverableSet | None:
                found = solve()
                self._solves.append(time.perf_counter() - begin)
                return found

            self._job = start_job(work)

    def _take_set(self) -> None:
        """Use the solved set, and start solving the next one."""
        job = self._job
        if job is None or not job.finished.is_set():
            return
        self._job = None
        if job.error is not None:
            raise job.error
        if self._filter.obstacles is not None:
            self._filter.use(job.result)
            self._counts["sets"] += 1
        self._solve()

    def _show(self) -> None:
        """Publish the pictures."""
        verdict, safety = self._verdict, self._filter
        if verdict is None:
            return
        stamp, frame = self.get_clock().now().to_msg(), self._odometry.frame
        found, state = safety.recoverable, verdict.state
        if found is not None:
            self._set.publish(slice_message(found, float(state[2]), float(state[3]), stamp, frame))
        if self._escape.get_subscription_count():
            width = 2.0 * safety.model.radius
            self._escape.publish(escape_marker(safety.escape(verdict), verdict.mode, width, stamp, frame))


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_safety safety_filter`."""
    return run_node(SafetyFilterNode)


if __name__ == "__main__":
    sys.exit(main())

"""The node between an environment and a robot: sensors in, raw commands out, operator take-over, filter status."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from ctrl_rl_core.policies import POSE_PARAMETERS, PoseInput
from ctrl_rl_core.ros import Status, seconds
from ctrl_rl_core.sensing import planar
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import Joy, LaserScan
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from ctrl_rl_core import (
    COMMAND,
    RESULT,
    SCAN_PARAMETERS,
    CtrlRlError,
    LidarRobot,
    Outcome,
    Parameter,
    PolicyManifest,
    PoseError,
    RobotNode,
    ScanGeometry,
    Sensors,
    read_goal,
)
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.on_robot.environment.operator import JoyMapping, Operator, Tally
from ctrl_rl_learning.on_robot.environment.robot import Driven, StepEnd
from ctrl_rl_msgs.msg import EpisodeStatus, SafetyStatus

Array = NDArray[np.float64]
NAME = "robot_learning"
RAW = "cmd_vel_raw"
_TOLD = "safety_filter/status"


class LearningNode(RobotNode):
    """Node that drives a robot for an environment by sending raw commands to the safety filter.

    Subscribes to scan, odom, goal_pose, episode, safety_filter/status, cmd_vel_operator, joy and the pose topic that
    the parameter `pose` names; publishes cmd_vel_raw and ~/taken_over. Services: ~/ready (the operator has put the
    robot back) and ~/finish (the operator ends the episode: true at the goal, false after a collision).
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *SCAN_PARAMETERS,
        Parameter("scan_timeout", 0.5, "Age of scan or odometry above which the robot stops [s].", 0.05, 10.0),
        *POSE_PARAMETERS,
        Parameter("operator_timeout", 0.5, "Age above which an operator's command expires [s].", 0.05, 10.0),
        Parameter("joy_button", 4, "Joystick button that the operator holds to take over.", 0, 100),
        Parameter("joy_speed_axis", 1, "Joystick axis for the speed.", 0, 100),
        Parameter("joy_turn_axis", 0, "Joystick axis for the turn rate.", 0, 100),
    )

    robot: LidarRobot

    def __init__(self, interface: PolicyManifest) -> None:
        """Create the node for a policy's interface."""
        super().__init__(NAME)
        low, high = np.array(interface.action.low), np.array(interface.action.high)
        self.robot = robot = LidarRobot(self)
        robot.set_limits(low, high)
        robot.on_scan, robot.on_odometry, robot.fault = self._take_scan, self._take_odometry, self._stale_scan
        self.operator = Operator(self.settings["operator_timeout"], low, high)
        value = self.settings
        self._joy = JoyMapping(value["joy_button"], value["joy_speed_axis"], value["joy_turn_axis"])
        self._needs_goal = interface.observes("goal")
        self._wanted, self._last = np.zeros(2), np.zeros(2)
        self._driving = False
        self._tally = Tally(self.robot.now(), self._last)
        self._odometry: Array | None = None
        self._odometry_stamp = -math.inf
        self._kept_at, self._scan_fault = -math.inf, ""
        self._scan: tuple[NDArray[np.float32], ScanGeometry, float] | None = None
        self._goal: tuple[Array, str] | None = None
        self._poses = PoseInput(self, robot.timeout, robot.now)
        self.status_of_filter: SafetyStatus | None = None
        self.episode: int | None = None
        self.outcome: Outcome | None = None
        self.ready = False
        self.create_subscription(PoseStamped, "goal_pose", self._on_goal, COMMAND)
        self.create_subscription(EpisodeStatus, "episode", self._on_episode, RESULT)
        self.create_subscription(SafetyStatus, _TOLD, self._on_status, RESULT)
        kind = TwistStamped if value["enable_stamped_cmd_vel"] else Twist
        self.create_subscription(kind, "cmd_vel_operator", self._on_operator, COMMAND)
        self.create_subscription(Joy, "joy", self._on_joy, COMMAND)
        self._taken_over = self.create_publisher(Bool, "~/taken_over", RESULT)
        self.create_service(Trigger, "~/ready", self._on_ready)
        self.create_service(SetBool, "~/finish", self._on_finish)
        topic = self.robot.output.publisher.topic_name
        if topic.rpartition("/")[2] == "cmd_vel":
            raise LearningError(f"commands would go to {topic} past the safety filter: remap cmd_vel to {RAW}")

    def is_filtered(self) -> bool:
        """Return whether a safety filter receives the raw commands and publishes its status."""
        return self.robot.output.publisher.get_subscription_count() > 0 and self.count_publishers(_TOLD) > 0

    def hold(self, command: Array) -> None:
        """Send a command (2,) now and repeat it with each scan, unless the operator drives."""
        self._driving, self._wanted = True, command
        self.send()

    def send(self) -> None:
        """Send the operator's command if there is one, else the held command."""
        if not self._driving:
            return
        taken = self.operator.command(self.robot.now())
        command = self._wanted if taken is None else taken
        try:
            self._last = self.robot.drive(command)
        except CtrlRlError as error:
            self.robot.halt(str(error))
            self._last = np.zeros(2)
        self._tally.sent(self.robot.now(), self._last, taken is not None)

    def rest(self) -> None:
        """Stop until the next call of `hold`."""
        self._driving, self._wanted, self._last = False, np.zeros(2), np.zeros(2)
        self.robot.drive(self._last)

    def begin_step(self, now: float) -> None:
        """Restart the step statistics at a time [s]."""
        self._tally = Tally(now, self._last)

    def end_step(self, now: float) -> Driven:
        """Return the commands since `begin_step`, and publish whether the operator took over."""
        driven = self._tally.end(now)
        self._taken_over.publish(Bool(data=driven.operator > 0.0))
        return driven

    def begin_episode(self, episode: int | None) -> None:
        """Accept the simulator's outcomes only for this episode number; None if no simulator reports outcomes."""
        self.episode, self.ready = episode, False
        self.outcome = None if episode is None else Outcome.RUNNING

    def reading(self, now: float) -> StepEnd:
        """Return the sensor readings, with the scan's age at the time `now` on the clock of its stamps [s].

        Raises:
            LearningError: An input is missing, stale or unusable.
        """
        problem = self.robot.input_fault()
        if problem or self._scan is None or self._odometry is None:
            raise LearningError(problem or "no recent scan")
        ranges, scan, stamp = self._scan
        try:
            pose = self._poses.pose()
            goal = None
            if self._needs_goal:
                if self._goal is None:
                    raise LearningError("waiting for goal_pose")
                goal = self._poses.place(*self._goal)
        except CtrlRlError as error:
            raise LearningError(str(error)) from None
        sensors = Sensors(ranges, scan, self._odometry, pose, goal, self._last, now, max(now - stamp, 0.0))
        return StepEnd(sensors, self.outcome, self._tally.late_scans)

    @property
    def scans(self) -> int:
        """Number of scans so far."""
        return self.robot.scans

    @property
    def held(self) -> Array:
        """Last command sent (2,)."""
        return self._last

    @property
    def odometry_stamp(self) -> float:
        """Stamp of the last odometry message [s]; -inf before the first one."""
        return self._odometry_stamp

    @property
    def stamp(self) -> float:
        """Stamp of the last scan [s]; -inf before the first one."""
        return -math.inf if self._scan is None else self._scan[2]

    def _stale_scan(self) -> str:
        """Return why the stored scan is too old to drive by, or an empty string if it is fresh."""
        if self._scan is None or self.robot.now() - self._kept_at <= self.robot.timeout:
            return ""
        return f"no recent scan to drive by: {self._scan_fault or 'all are out of order'}"

    def _take_odometry(self, message: Odometry, odometry: Array) -> None:
        """Store the odometry for the next reading."""
        self._odometry, self._odometry_stamp = odometry, seconds(message.header.stamp)
        self._poses.on_odometry(message, self.robot.frame)

    def _take_scan(self, message: LaserScan, ranges: NDArray[np.float32], scan: ScanGeometry) -> None:
        """Store the newest scan and resend the held command.

        A scan from the future is dropped, because all later scans would then seem late. After a simulator restart the
        first scan with a new stamp replaces the stored one.
        """
        stamp, clock = seconds(message.header.stamp), self.get_clock().now().nanoseconds * 1e-9
        ahead = clock > 0.0 and stamp - clock > self.robot.timeout
        before = stamp < self.stamp <= clock + self.robot.timeout
        self._tally.late_scans += ahead or before or clock - stamp > self.robot.timeout
        if not (ahead or before):
            self._scan, self._kept_at = (ranges.copy(), scan, stamp), self.robot.now()
        self._scan_fault = f"a scan of {stamp - clock:.1f} s ahead of the clock" if ahead else ""
        self.send()

    def status(self) -> Status:
        """Return whether commands are sent, and who gives them."""
        level, message, figures = super().status()
        taken = self.operator.command(self.robot.now()) is not None
        return level, message, {**figures, "taken over": str(taken).lower(), "refused": self.operator.refused}

    def _on_operator(self, message: Twist | TwistStamped) -> None:
        twist = message.twist if isinstance(message, TwistStamped) else message
        self.operator.on_command(twist.linear.x, twist.angular.z, self.robot.now())
        self.send()

    def _on_joy(self, message: Joy) -> None:
        self.operator.on_joy(message.axes, message.buttons, self._joy, self.robot.now())
        self.send()

    def _on_status(self, message: SafetyStatus) -> None:
        self.status_of_filter = message
        self._tally.answered(message.mode != SafetyStatus.PASSED)

    def _on_episode(self, message: EpisodeStatus) -> None:
        known = {value.value for value in Outcome}
        if message.episode == self.episode and message.outcome.value in known and self.outcome is Outcome.RUNNING:
            self.outcome = Outcome(message.outcome.value)

    def _on_goal(self, message: PoseStamped) -> None:
        try:
            self._goal = planar(read_goal(message.pose).tolist()), message.header.frame_id.lstrip("/")
        except PoseError as error:
            self.get_logger().warning(f"goal_pose refused: {error}")

    def _on_ready(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.ready = response.success = True
        response.message = "the next episode begins"
        return response

    def _on_finish(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.outcome = Outcome.GOAL if request.data else Outcome.COLLISION
        response.success, response.message = True, f"the episode ends: {self.outcome.words}"
        return response

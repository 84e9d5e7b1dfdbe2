"""The navigator node: map, goal, pose and scan in; velocity, path, value and status out."""

from __future__ import annotations

import math
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from ctrl_rl_core.navigation import Transform, TransformError
from ctrl_rl_core.policies import PoseInput
from ctrl_rl_core.ros import LATCHED, Status, answer, nanoseconds, ok, warn
from ctrl_rl_core.sensing import ODOMETRY_NAMES
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from ctrl_rl_core import (
    CtrlRlError,
    LidarRobot,
    OccupancyMap,
    Parameter,
    RobotNode,
    ScanGeometry,
    Sensors,
    VelocityError,
    make_odometry,
    run_node,
)
from ctrl_rl_msgs.msg import NavigatorStatus
from ctrl_rl_msgs.srv import QueryValues
from ctrl_rl_navigation.driving.decision import NavigatorState
from ctrl_rl_navigation.driving.navigator_driver import NavigatorDriver
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.maps import load_map
from ctrl_rl_navigation.nodes.messages import goal_from, path_message, slice_message, status_message
from ctrl_rl_navigation.nodes.navigators import make_navigator
from ctrl_rl_navigation.nodes.parameters import ANY_HEADING, NAVIGATOR_PARAMETERS

if TYPE_CHECKING:
    from ctrl_rl_navigation.nodes.action_servers import NavigatorActions

Array = NDArray[np.float64]

_STATUS_PERIOD = 0.5
_LAST_ZEROS = 10
"""Number of zero commands at the end of a drive, after which the topic is free for others."""
_SCANS = 4
"""Number of scans processed for each command; of more, as in a flood, only the last one before the command counts."""
_FINE = (NavigatorState.DRIVING, NavigatorState.REACHED, NavigatorState.SOLVING)
_STAND = np.zeros(2)
_NOWHERE = Transform.planar(0.0, 0.0, 0.0)
_NO_SCAN = np.empty(0, np.float32), ScanGeometry(0, 0.0, 1.0, 0.0, 1.0)
"""Sensors for command requests; scans are passed on separately as they arrive."""


class NavigatorNode(RobotNode):
    """Drives a robot to goals on a map, based on the time to reach them.

    Subscribes to map, goal_pose, scan, odom, and /tf or amcl_pose; publishes cmd_vel, path, ~/status and ~/slice, and
    answers ~/query and ~/cancel. It serves the actions navigate_to_pose, navigate_through_poses, follow_waypoints and
    follow_path of Nav2. Without a recent scan, odometry and pose on the map, the robot stops.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = NAVIGATOR_PARAMETERS
    robot: LidarRobot

    def __init__(self) -> None:
        super().__init__("navigator")
        value = self.settings
        self._navigator, bounds = make_navigator(value)
        self.robot = robot = LidarRobot(self)
        robot.set_limits(*bounds)
        robot.on_scan, robot.on_odometry = self._see, self._keep
        self._driver = NavigatorDriver(self._navigator, value["lidar_x"])
        self._odometry, self._sent = np.zeros(len(ODOMETRY_NAMES)), _STAND
        self._map: OccupancyMap | None = None
        self._zeros = self._processed = 0
        self._waiting: tuple[LaserScan, NDArray[np.float32], ScanGeometry] | None = None
        self._shown: tuple[Any, Any] = (None, None)
        self._input = PoseInput(self, robot.timeout, robot.now)
        self._pose: Array | None = None
        self._told = self.create_publisher(NavigatorStatus, "~/status", LATCHED)
        self._path = self.create_publisher(Path, "path", LATCHED)
        self._slice = self.create_publisher(OccupancyGrid, "~/slice", LATCHED)
        if value["map"]:
            self._use(load_map(value["map"]))
        else:
            self.create_subscription(OccupancyGrid, "map", self._on_map, LATCHED)
        self.create_service(QueryValues, "~/query", self._on_query)
        self.create_service(Trigger, "~/cancel", self._on_cancel)
        self.create_timer(value["control_period"], self._tick)
        self.create_timer(_STATUS_PERIOD, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._actions = self._serve_actions()
        if value["actions"] != "follow_path":  # last: goals arrive from now on
            self.create_subscription(PoseStamped, "goal_pose", self._on_goal, 10)

    def forget(self) -> None:
        """Drop the goal."""
        self._navigator.cancel()

    def _serve_actions(self) -> NavigatorActions | None:
        """Return the action servers; None without any, and where ROS has no nav2_msgs."""
        if self.settings["actions"] == "none":
            return None
        try:
            from ctrl_rl_navigation.nodes.action_servers import NavigatorActions
        except ModuleNotFoundError as error:
            if error.name is None or error.name.partition(".")[0] != "nav2_msgs":
                raise
            self.get_logger().warning("no actions are served: they need nav2_msgs (apt install ros-jazzy-nav2-msgs)")
            return None
        return NavigatorActions(self, self.robot, self._navigator, self._frame, self._tick)

    def _keep(self, message: Odometry, odometry: Array) -> None:
        """Store the odometry pose."""
        self._odometry = odometry
        self._input.on_odometry(message, self.robot.frame)

    def _see(self, message: LaserScan, ranges: NDArray[np.float32], scan: ScanGeometry) -> None:
        """Take a scan in: at once, unless there are many."""
        self._waiting = (message, ranges, scan)
        if self._processed < _SCANS:
            self._process()

    def _process(self) -> None:
        """Pass the last scan to the driver, with the pose at its time."""
        if self._waiting is None:
            return
        (message, ranges, scan), self._waiting = self._waiting, None
        self._processed += 1
        track, pose = self._input.track, None
        try:
            there = track.at(nanoseconds(message.header.stamp))
        except TransformError:  # clocks of scan and odometry differ: treat the scan as current
            there = track.latest() if track.heard > -math.inf else _NOWHERE
        with suppress(TransformError):  # the pose may be known at the next scan
            pose = (Transform.planar(*self._input.pose().tolist()) @ track.latest().inverse() @ there).pose
        odometry = make_odometry(there.pose, np.zeros(3))
        self._driver.see(Sensors(ranges, scan, odometry, pose, None, self._sent, self.robot.now()))

    def status(self) -> Status:
        """Report the navigator's state."""
        level, message, figures = super().status()
        decision = self._driver.decision
        figures = {
            **figures,
            "state": decision.state.name.lower(),
            "remaining time [s]": f"{decision.remaining_time:.1f}",
            "remaining distance [m]": f"{self._navigator.remaining_distance:.1f}",
            "detour [s]": f"{self._navigator.detour:.1f}",
            "values solved": self._navigator.solves,
            "refused": self._input.refused,
        }
        if figures["other publishers"] or decision.state is NavigatorState.DRIVING:
            return level, message, figures
        return (ok if decision.state in _FINE or self._is_idle() else warn)(decision.message, **figures)

    def _use(self, map_: OccupancyMap) -> None:
        """Use a map unless it is already in use."""
        if self._map is None or not self._map.is_same(map_):
            self._map = map_
            self._navigator.set_map(map_)
            width, height = map_.size
            self.get_logger().info(f"a map of {width:.1f} x {height:.1f} m at {map_.resolution:g} m")

    def _on_map(self, message: OccupancyGrid) -> None:
        frame = message.header.frame_id.lstrip("/")
        if frame not in ("", self.settings["map_frame"]):
            self.get_logger().warning(f"a map in frame '{frame}' is not used: parameter 'map_frame' names another")
            return
        try:
            self._use(OccupancyMap.from_message(message))
        except CtrlRlError as error:
            self.get_logger().error(f"the map is not used: {error}")

    def _on_goal(self, message: PoseStamped) -> None:
        try:
            if not self.is_active:
                raise NavigationError("the node is inactive")
            frame = self._frame(message.header.frame_id.lstrip("/"))
            goal = goal_from(message, frame, self.settings["goal_heading_tolerance"] < ANY_HEADING)
        except CtrlRlError as error:
            self._input.refused = f"goal: {error}"
            self.get_logger().error(f"the goal is refused: {error}")
            return
        self.get_logger().info(f"goal ({goal.position[0]:.2f}, {goal.position[1]:.2f})")
        if self._actions is not None:
            self._actions.replace("a goal on goal_pose replaces this one")
        self._navigator.set_goal(goal)

    def _on_cancel(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._actions is not None:
            self._actions.replace("the goal was cancelled by ~/cancel")
        response.success = self._navigator.cancel()
        response.message = "the goal is cancelled" if response.success else "there is no goal"
        self._tick()
        return response

    def _on_query(self, request: QueryValues.Request, response: QueryValues.Response) -> QueryValues.Response:
        value = self._navigator.value
        if value is None:
            response.success, response.message = False, "there is no value, because there is no goal"
            return response
        answer(value, request, response)
        return response

    def _frame(self, name: str) -> Transform:
        """Return the pose of a frame in the map frame; an empty name is the map frame.

        Raises:
            TransformError: The frame is unknown.
        """
        return _NOWHERE if name in ("", self.settings["map_frame"]) else self._input.frame_in_map(name)

    def _tick(self) -> None:
        """Decide, send the command, and report changes."""
        before = self._driver.decision
        self._process()
        self._processed = 0
        self._drive()
        decision = self._driver.decision
        if (before.state, _words(before.message)) != (decision.state, _words(decision.message)):
            self.get_logger().info(decision.message)
            self._tell()
        self._show()
        if self._actions is not None:
            self._actions.update(decision, self._pose)

    def _drive(self) -> None:
        """Send the driver's command, or stop if an input is missing."""
        robot, driver, problem = self.robot, self._driver, self.robot.input_fault()
        try:
            self._pose = pose = self._input.pose()
        except TransformError as error:
            self._pose, problem = None, problem or str(error)
        if problem:
            self._sent = driver.wait(robot.now(), problem)
            if self._navigator.goal is not None and not self._is_idle():
                robot.halt(problem)
            return
        command = driver.command(Sensors(*_NO_SCAN, self._odometry, pose, None, self._sent, robot.now(), math.inf))
        driving = driver.decision.state is NavigatorState.DRIVING
        self._zeros = 0 if command.any() or driving else self._zeros + 1
        if self._zeros > _LAST_ZEROS and not robot.moving:
            robot.problem = ""
            return
        try:
            self._sent = robot.drive(command)
        except VelocityError as error:
            robot.halt(str(error))
            self._sent = driver.wait(robot.now(), str(error), driver.decision.remaining_time)

    def _is_idle(self) -> bool:
        return self._zeros > _LAST_ZEROS

    def _report(self) -> None:
        """Publish the status; if the simulated clock stands still, also stop the robot."""
        if self.robot.stale_input():
            self._tick()
        self._tell()

    def _tell(self) -> None:
        """Publish the status."""
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self.settings["map_frame"])
        self._told.publish(status_message(self._navigator, self._driver.decision, header))

    def _show(self) -> None:
        """Publish path and value if they have changed."""
        path, value = self._navigator.path, self._navigator.value
        stamp, frame = self.get_clock().now().to_msg(), self.settings["map_frame"]
        if path is not self._shown[0]:
            self._path.publish(path_message(path, Header(stamp=stamp, frame_id=frame)))
        if value is not None and value is not self._shown[1]:
            self._slice.publish(slice_message(value, stamp, frame))
            self.get_logger().info(f"the value of the goal is solved in {value.seconds:.2f} s")
        self._shown = (path, value)


def _words(message: str) -> str:
    """Return a message with its numbers removed."""
    return "".join(letter for letter in message if not letter.isdigit())


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_navigation navigator`."""
    return run_node(NavigatorNode)


if __name__ == "__main__":
    sys.exit(main())

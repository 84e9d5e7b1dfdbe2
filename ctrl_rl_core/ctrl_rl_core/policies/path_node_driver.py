"""The action follow_path of Nav2 for any driver of a `DriverNode`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from std_msgs.msg import Header

from ctrl_rl_core.driving.commander import VelocityError
from ctrl_rl_core.driving.driver_node import DriverNode, NodeDriver
from ctrl_rl_core.driving.path_driver import PathDriver
from ctrl_rl_core.navigation.transform_tree import TransformError
from ctrl_rl_core.policies.pose_input import PoseInput
from ctrl_rl_core.ros.goal_server import ActiveGoal, GoalError, GoalServer
from ctrl_rl_core.ros.parameters import Parameter, ParameterError
from ctrl_rl_core.sensing.scan import Sensors
from ctrl_rl_msgs.msg import EpisodeStatus

Array = NDArray[np.float64]

PATH_PARAMETERS = (
    Parameter(
        "follow_path",
        False,
        "Drive only along paths of the action follow_path, in the place of Nav2's controller; a driver sees each path "
        "as a corridor in the scan.",
    ),
    Parameter("path_width", 0.7, "Width of the corridor that the driver sees around a path [m].", 0.1, 20.0),
    Parameter("path_tolerance", 0.15, "Distance from the end of a path at which it is reached [m].", 0.01, 5.0),
    Parameter("path_patience", 20.0, "Time without progress along a path after which it is aborted [s].", 1.0, 86400.0),
)
_WAITING = "waiting for a path (action follow_path)"
_MOST_POSES, _LONGEST = 20_000, 1000.0
_PROGRESS = 0.05
"""Distance along the path that counts as progress [m]."""


class PathNodeDriver(NodeDriver):
    """Lets a driver follow paths; without one the robot stands.

    Args:
        node: Node with `PATH_PARAMETERS` and `POSE_PARAMETERS`.
        driver: Driver of a robot on wheels.

    Raises:
        ParameterError: The driver flies a quadrotor, or ROS has no nav2_msgs.
    """

    def __init__(self, node: DriverNode, driver: NodeDriver) -> None:
        try:
            from nav2_msgs.action import FollowPath
        except ModuleNotFoundError:
            raise ParameterError("follow_path needs nav2_msgs: apt install ros-jazzy-nav2-msgs") from None
        if driver.thrusts_at_rest is not None:
            raise ParameterError("follow_path is for robots on wheels, and this driver flies a quadrotor")
        self._node, self._driver, self._codes = node, driver, FollowPath.Result
        self._poses = PoseInput(node, float(node.settings["scan_timeout"]), lambda: node.robot.now())
        self._path: PathDriver | None = None
        self._goal: ActiveGoal | None = None
        self._best, self._best_at = math.inf, math.inf
        GoalServer(node, FollowPath, "follow_path", self._begin, self._cancel)

    @property
    def limits(self) -> tuple[Array, Array]:  # type: ignore[override]
        """Minimum and maximum command of the driver (2,), (2,)."""
        return self._driver.limits

    def command(self, sensors: Sensors) -> Array:
        """Return the driver's command along the path.

        Raises:
            CtrlRlError: There is no path, no pose or no command.
        """
        if self._path is None:
            raise VelocityError(_WAITING)
        return self._path.command(sensors._replace(pose=self._poses.pose()))

    def on_sent(self, header: Header, command: Array, problem: str) -> None:
        """Report to the client, and end the goal at the end of the path or without progress."""
        self._driver.on_sent(header, command, problem)
        goal, path, now = self._goal, self._path, self._node.robot.now()
        if goal is None or path is None:
            return
        left = path.view.left
        if path.arrived:
            self._end()
            goal.succeed()
        elif left < self._best - _PROGRESS or self._best_at > now:  # progress, or a clock that was set back
            self._best, self._best_at = left, now
        elif now - self._best_at > self._node.settings["path_patience"]:
            self._end()
            why = f": {problem}" if problem else ""
            goal.abort(
                f"no progress along the path for {now - self._best_at:.0f} s{why}", self._codes.FAILED_TO_MAKE_PROGRESS
            )
        goal.feedback(distance_to_goal=left, speed=float(self._node.robot.motion[0]))

    def on_odometry(self, message: Odometry) -> None:
        """Store the pose."""
        self._poses.on_odometry(message, self._node.robot.frame)
        self._driver.on_odometry(message)

    def on_episode(self, message: EpisodeStatus) -> None:
        """Pass the episode on."""
        self._driver.on_episode(message)

    def forget(self) -> None:
        """Drop the path."""
        self._end()
        self._driver.forget()

    def use_parameter(self, name: str) -> None:
        """Pass a changed parameter on."""
        self._driver.use_parameter(name)

    def figures(self) -> Mapping[str, object]:
        """Report the driver's figures and the path."""
        path = "none" if self._path is None else f"{self._path.view.left:.1f} m left"
        return {**self._driver.figures(), "path": path}

    def _begin(self, goal: ActiveGoal) -> None:
        """Start along another path, at once.

        Raises:
            GoalError: The path or its frame is unusable.
        """
        settings = self._node.settings
        low, high = self.limits
        places = self._read(goal.request.path)
        self._end("another path replaces this one")
        self._path = PathDriver(
            self._driver,
            places,
            0.5 * settings["path_width"],
            settings["path_tolerance"],
            float(min(-low[1], high[1])),
            settings["deceleration"],
            settings["lidar_x"],
        )
        self._goal, self._best = goal, math.inf
        self._node.get_logger().info(f"a path of {self._path.view.length:.1f} m")

    def _read(self, path: Any) -> Array:
        """Return the positions of a path in the frame of the poses (n, 2) [m]."""
        invalid = self._codes.INVALID_PATH
        if not 0 < len(path.poses) <= _MOST_POSES:
            raise GoalError(f"a path of {len(path.poses)} poses: must be 1 to {_MOST_POSES}", invalid)
        places = np.array([(each.pose.position.x, each.pose.position.y) for each in path.poses])
        if not (np.abs(places) < 1e6).all():
            raise GoalError("the path has a position that is not finite", invalid)
        name = (path.header.frame_id or path.poses[-1].header.frame_id).lstrip("/")
        try:
            x, y, yaw = self._poses.frame_in_map(name).pose.tolist()
            c, s = math.cos(yaw), math.sin(yaw)
            places = places @ np.array(((c, s), (-s, c))) + (x, y)
            length = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
            if length < _PROGRESS:  # a single place
                places = np.vstack((self._poses.pose()[:2], places[-1]))
        except TransformError as error:
            raise GoalError(str(error), self._codes.TF_ERROR) from None
        if length > _LONGEST:
            raise GoalError(f"the path is longer than {_LONGEST:g} m", invalid)
        return places

    def _cancel(self, goal: ActiveGoal) -> None:
        """Stop the robot, then tell the client."""
        if goal is self._goal:
            self._path = self._goal = None
            self._node.robot.halt("the path was cancelled")
        goal.cancelled()

    def _end(self, reason: str = "") -> None:
        """Drop the path; for a reason, abort it too."""
        goal, self._goal, self._path = self._goal, None, None
        if reason and goal is not None:
            goal.abort(reason)


def follow_paths(make_driver: Callable[[DriverNode], NodeDriver]) -> Callable[[DriverNode], NodeDriver]:
    """Return a maker of the same driver, which follows paths if the parameter `follow_path` says so."""

    def make(node: DriverNode) -> NodeDriver:
        driver = make_driver(node)
        return PathNodeDriver(node, driver) if node.settings["follow_path"] else driver

    return make

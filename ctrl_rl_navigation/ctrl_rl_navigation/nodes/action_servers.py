"""The navigator's action servers, which clients of Nav2 use: poses, poses to pass, waypoints and paths."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from ctrl_rl_core.navigation import Transform, TransformError
from ctrl_rl_core.ros import ActiveGoal, GoalError, GoalServer
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import FollowPath, FollowWaypoints, NavigateThroughPoses, NavigateToPose
from nav2_msgs.msg import MissedWaypoint
from numpy.typing import NDArray
from std_msgs.msg import Header

from ctrl_rl_core import LidarRobot, SuiteNode
from ctrl_rl_navigation.cars import CarNavigator
from ctrl_rl_navigation.driving.decision import Decision, Goal
from ctrl_rl_navigation.driving.journey import Failure, Journey
from ctrl_rl_navigation.driving.navigator import Navigator
from ctrl_rl_navigation.driving.path_legs import Leg, legs_along, legs_to
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.nodes.messages import goal_from, planar_pose
from ctrl_rl_navigation.nodes.parameters import ANY_HEADING

Array = NDArray[np.float64]

_MOST_POSES, _MOST_GOALS = 20_000, 1000
"""Largest numbers of poses of a path, and of goals on a journey."""
_NO_PLAN, _BAD_PLAN, _NO_FRAME = 208, 200, 202
"""Codes of Nav2's planner: NO_VALID_PATH, UNKNOWN and TF_ERROR."""
_STUCK, _NO_SENSES, _BAD_PATH = (
    FollowPath.Result.FAILED_TO_MAKE_PROGRESS,
    FollowPath.Result.TF_ERROR,
    FollowPath.Result.INVALID_PATH,
)
_CODES = {Failure.NO_WAY: _NO_PLAN, Failure.BLOCKED: _STUCK, Failure.NO_INPUT: _NO_SENSES, Failure.REPLACED: 0}


class NavigatorActions:
    """Serves navigate_to_pose, navigate_through_poses, follow_waypoints and follow_path, one goal at a time.

    Args:
        node: Node of the navigator, with its settings.
        robot: Its robot.
        navigator: The navigator.
        frame: Returns the pose of a frame in the map frame; raises TransformError.
        stop: Stops the robot at once if the navigator has no goal.
    """

    def __init__(
        self,
        node: SuiteNode,
        robot: LidarRobot,
        navigator: Navigator | CarNavigator,
        frame: Callable[[str], Transform],
        stop: Callable[[], None],
    ) -> None:
        self._node, self._robot, self._navigator, self._frame, self._stop = node, robot, navigator, frame, stop
        self._pose: Array | None = None
        self._active: ActiveGoal | None = None
        self._journey: Journey | None = None
        self._begun = 0
        served: dict[str, dict[str, tuple[Any, Callable[[ActiveGoal], None]]]] = {
            "navigate": {
                "navigate_to_pose": (NavigateToPose, self._on_pose),
                "navigate_through_poses": (NavigateThroughPoses, self._on_poses),
                "follow_waypoints": (FollowWaypoints, self._on_waypoints),
            },
            "follow_path": {"follow_path": (FollowPath, self._on_path)},
        }
        chosen = node.settings["actions"]
        for group, actions in served.items():
            if chosen in (group, "all"):
                for name, (kind, begin) in actions.items():
                    GoalServer(node, kind, name, begin, self._on_cancel)

    def update(self, decision: Decision, pose: Array | None) -> None:
        """Report a decision at a pose (3,) to the client, and end the goal where the journey has ended."""
        self._pose, journey, active = pose, self._journey, self._active
        if journey is None or active is None:
            return
        journey.update(self._robot.now(), decision, pose)
        if journey.failure is not None:
            self._end(lambda goal: self._abort(goal, journey))
        elif journey.arrived:
            self._node.get_logger().info("the goal of the action is reached")
            self._end(lambda goal: goal.succeed())
        elif pose is not None:
            self._report(active, journey, decision, pose)

    def replace(self, reason: str) -> None:
        """Abort the goal because another one or a cancel has taken over the navigator."""
        self._end(lambda goal: goal.abort(reason))

    def _on_pose(self, goal: ActiveGoal) -> None:
        self._begin(goal, legs_to([self._read(goal.request.pose)]), stops=True)

    def _on_poses(self, goal: ActiveGoal) -> None:
        self._begin(goal, self._legs(goal.request.poses), stops=False)

    def _on_waypoints(self, goal: ActiveGoal) -> None:
        request, most = goal.request, _MOST_GOALS // max(len(goal.request.poses), 1)
        if request.goal_index > len(request.poses) or request.number_of_loops >= max(most, 1):
            raise GoalError("goal_index or number_of_loops is too large", FollowWaypoints.Result.UNKNOWN)
        poses = [*request.poses[request.goal_index :], *(request.number_of_loops * list(request.poses))]
        self._begin(goal, self._legs(poses), stops=True)

    def _on_path(self, goal: ActiveGoal) -> None:
        if isinstance(self._navigator, CarNavigator):
            raise GoalError("a car does not follow paths: send poses", FollowPath.Result.INVALID_CONTROLLER)
        path, settings = goal.request.path, self._node.settings
        if not 0 < len(path.poses) <= _MOST_POSES:
            raise GoalError(f"a path of {len(path.poses)} poses: must be 1 to {_MOST_POSES}", _BAD_PATH)
        name = path.header.frame_id or path.poses[-1].header.frame_id
        try:
            frame = self._frame(name.lstrip("/"))
            places = np.array([(each.pose.position.x, each.pose.position.y) for each in path.poses])
            if not np.isfinite(places).all():
                raise GoalError("the path has a position that is not finite", _BAD_PATH)
            end = self._goal_from(path.poses[-1], frame)
            legs = legs_along(_in_map(frame, places), end.heading, settings["path_corridor"], self._pose)
        except TransformError as error:
            raise GoalError(str(error), _NO_SENSES) from None
        except NavigationError as error:
            raise GoalError(str(error), _BAD_PATH) from None
        self._begin(goal, legs, stops=False)

    def _legs(self, poses: list[PoseStamped]) -> list[Leg]:
        if not 0 < len(poses) <= _MOST_GOALS:
            raise GoalError(f"{len(poses)} poses: must be 1 to {_MOST_GOALS}", _BAD_PLAN)
        return legs_to([self._read(each) for each in poses])

    def _read(self, pose: PoseStamped) -> Goal:
        """Return a goal in the map frame.

        Raises:
            GoalError: The pose is invalid, or its frame is unknown.
        """
        try:
            return self._goal_from(pose, self._frame(pose.header.frame_id.lstrip("/")))
        except TransformError as error:
            raise GoalError(str(error), _NO_FRAME) from None
        except NavigationError as error:
            raise GoalError(str(error), _BAD_PLAN) from None

    def _goal_from(self, pose: PoseStamped, frame: Transform) -> Goal:
        turn = pose.pose.orientation
        if turn.x == turn.y == turn.z == turn.w == 0.0:
            raise NavigationError("the goal's quaternion is all zeros: w = 1.0 is heading 0")
        return goal_from(pose, frame, self._node.settings["goal_heading_tolerance"] < ANY_HEADING)

    def _begin(self, goal: ActiveGoal, legs: list[Leg], stops: bool) -> None:
        self.replace("another goal replaces this one")
        settings = self._node.settings
        self._journey = Journey(self._navigator, legs, settings["max_speed"], settings["goal_patience"], stops)
        self._active, self._begun = goal, self._now()
        x, y = legs[-1].goal.position
        many = f" by {len(legs)} legs" if len(legs) > 1 else ""
        self._node.get_logger().info(f"{goal.kind.__name__} to ({x:.2f}, {y:.2f}){many}")

    def _on_cancel(self, goal: ActiveGoal) -> None:
        """Stop the robot, then tell the client."""
        if goal is self._active:
            self._active = self._journey = None
            self._navigator.cancel()
            self._stop()
        goal.cancelled()

    def _end(self, end: Callable[[ActiveGoal], None]) -> None:
        """End the goal, if there is one."""
        active, self._active, self._journey = self._active, None, None
        if active is not None:
            end(active)

    def _abort(self, goal: ActiveGoal, journey: Journey) -> None:
        assert journey.failure is not None
        code, fields = _CODES[journey.failure], {}
        self._node.get_logger().warning(f"the goal of the action is aborted: {journey.reason}")
        if goal.kind is FollowPath and journey.failure is Failure.NO_WAY:
            code = _BAD_PATH
        if goal.kind is FollowWaypoints:
            poses, first = goal.request.poses, goal.request.goal_index
            index = (first + journey.index) % len(poses)
            fields["missed_waypoints"] = [MissedWaypoint(index=index, goal=poses[index], error_code=code)]
            code = FollowWaypoints.Result.UNKNOWN
        goal.abort(journey.reason, code, **fields)

    def _report(self, goal: ActiveGoal, journey: Journey, decision: Decision, pose: Array) -> None:
        distance, seconds = journey.remaining(decision, pose)
        if goal.kind is FollowPath:
            goal.feedback(distance_to_goal=distance, speed=float(self._robot.motion[0]))
            return
        if goal.kind is FollowWaypoints:
            poses, first = goal.request.poses, goal.request.goal_index
            goal.feedback(current_waypoint=(first + journey.index) % len(poses))
            return
        through = goal.kind is NavigateThroughPoses
        fields: dict[str, Any] = {"number_of_poses_remaining": journey.left} if through else {}
        goal.feedback(
            current_pose=self._stamped(pose),
            navigation_time=_duration(1e-9 * (self._now() - self._begun)),
            estimated_time_remaining=_duration(seconds),
            number_of_recoveries=journey.recoveries,
            distance_remaining=distance,
            **fields,
        )

    def _stamped(self, pose: Array) -> PoseStamped:
        stamp = self._node.get_clock().now().to_msg()
        header = Header(stamp=stamp, frame_id=self._node.settings["map_frame"])
        return PoseStamped(header=header, pose=planar_pose(*pose.tolist()))

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)


def _in_map(frame: Transform, places: Array) -> Array:
    """Return positions (n, 2) [m] of a frame in the map frame."""
    x, y, yaw = frame.pose.tolist()
    c, s = math.cos(yaw), math.sin(yaw)
    return np.asarray(places @ np.array(((c, s), (-s, c))) + (x, y))


def _duration(seconds: float) -> Duration:
    whole = math.floor(max(seconds, 0.0))
    return Duration(sec=min(whole, 2**31 - 1), nanosec=int(1e9 * max(seconds - whole, 0.0)))

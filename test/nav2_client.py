"""A client of Nav2's actions with the methods of nav2_simple_commander's `BasicNavigator`."""
# ruff: noqa: N802

import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import FollowPath, FollowWaypoints, NavigateThroughPoses, NavigateToPose
from nav_msgs.msg import Path
from rclpy.action import ActionClient
from rclpy.node import Node


class Nav2Client(Node):
    """Sends one goal after the other, and tells of feedback and results."""

    def __init__(self, name: str = "application", namespace: str = "") -> None:
        super().__init__(name, namespace=namespace)
        self.feedback: Any = None
        self.heard: list[Any] = []
        self._clients_of = {
            kind: ActionClient(self, kind, action)
            for kind, action in (
                (NavigateToPose, "navigate_to_pose"),
                (NavigateThroughPoses, "navigate_through_poses"),
                (FollowWaypoints, "follow_waypoints"),
                (FollowPath, "follow_path"),
            )
        }

    def goToPose(self, pose: PoseStamped) -> bool:
        return self.send(NavigateToPose, NavigateToPose.Goal(pose=pose))

    def goThroughPoses(self, poses: Sequence[PoseStamped]) -> bool:
        return self.send(NavigateThroughPoses, NavigateThroughPoses.Goal(poses=poses))

    def followWaypoints(self, poses: Sequence[PoseStamped]) -> bool:
        return self.send(FollowWaypoints, FollowWaypoints.Goal(poses=poses))

    def followPath(self, path: Path) -> bool:
        return self.send(FollowPath, FollowPath.Goal(path=path))

    def send(self, kind: Any, goal: Any) -> bool:
        client = self._clients_of[kind]
        assert client.wait_for_server(60.0)
        heard = list[Any]()
        self.feedback, self.heard = None, heard

        def on_feedback(message: Any) -> None:
            heard.append(message.feedback)
            if self.heard is heard:  # not of a goal before
                self.feedback = message.feedback

        for _ in range(6):
            future = client.send_goal_async(goal, on_feedback)
            rclpy.spin_until_future_complete(self, future, timeout_sec=10.0)
            if future.done():
                break
            # `wait_for_server` tells that this client has found the server. The server may not have found this client
            # yet, and then the middleware drops the answer. The goal that is sent again replaces the one before.
        self.goal_handle = future.result()
        assert self.goal_handle is not None, "no answer to a goal in 60 s"
        if not self.goal_handle.accepted:
            return False
        self.result = self.goal_handle.get_result_async()
        return True

    def isTaskComplete(self) -> bool:
        rclpy.spin_until_future_complete(self, self.result, timeout_sec=0.1)
        return bool(self.result.done())

    def getFeedback(self) -> Any:
        return self.feedback

    def cancelTask(self) -> None:
        future = self.goal_handle.cancel_goal_async()
        rclpy.spin_until_future_complete(self, future, timeout_sec=60.0)

    def getResult(self) -> tuple[int, Any]:
        """Return the status of the last goal, as in action_msgs/GoalStatus, and the result message."""
        return self.result.result().status, self.result.result().result

    def client_of(self, kind: Any) -> ActionClient:
        return self._clients_of[kind]

    def wait_for(self, fits: Callable[[], bool], longest: float = 60.0) -> None:
        deadline = time.monotonic() + longest
        while not fits():
            rclpy.spin_once(self, timeout_sec=0.05)
            assert time.monotonic() < deadline

    def wait(self, fits: Callable[[], bool] | None = None, longest: int = 1200) -> None:
        """Return once the task is complete, or once something fits."""
        for _ in range(longest):
            if self.isTaskComplete() or (fits is not None and fits()):
                return
        raise AssertionError(f"the task takes too long: {self.feedback}")


SUCCEEDED, CANCELED, ABORTED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED


def pose_at(x: float, y: float, frame: str = "map", w: float = 1.0) -> PoseStamped:
    out = PoseStamped()
    out.header.frame_id = frame
    out.pose.position.x, out.pose.position.y, out.pose.orientation.w = x, y, w
    return out


def path_through(*places: tuple[float, float], frame: str = "map") -> Path:
    out = Path()
    out.header.frame_id = frame
    out.poses = [pose_at(x, y, frame) for x, y in places]
    return out

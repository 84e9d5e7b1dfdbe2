"""The navigator as a real node beside the simulator: goals, cancelling, unreachable ones, and what it waits for."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import rclpy
from ctrl_rl_core.ros.node import LATCHED
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from std_srvs.srv import Trigger

from ctrl_rl_msgs.msg import NavigatorStatus
from ctrl_rl_msgs.srv import QueryValues

START_TO_GOAL = (2.0, 1.0)
"""Place in the corridor, behind its first turn."""


class Operator:
    """Clicks goals and watches what the navigator tells."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("operator")
        self.status: list[NavigatorStatus] = []
        self.paths: list[Path] = []
        self.slices: list[OccupancyGrid] = []
        self._goal = self.node.create_publisher(PoseStamped, "goal_pose", 10)
        self.node.create_subscription(NavigatorStatus, "navigator/status", self.status.append, LATCHED)
        self.node.create_subscription(Path, "path", self.paths.append, LATCHED)
        self.node.create_subscription(OccupancyGrid, "navigator/slice", self.slices.append, LATCHED)

    def wait(self, fits: Callable[[], bool], timeout: float = 120.0) -> None:
        deadline = time.monotonic() + timeout
        while not fits():
            rclpy.spin_once(self.node, timeout_sec=0.05)
            assert time.monotonic() < deadline, self.status[-3:]

    def wait_for(self, state: int, words: str = "") -> NavigatorStatus:
        self.status.clear()
        self.wait(lambda: any(each.state == state and words in each.message for each in self.status))
        return self.status[-1]

    def click(self, x: float, y: float, frame: str = "map") -> None:
        self.wait(lambda: self._goal.get_subscription_count() > 0)
        message = PoseStamped()
        message.header.frame_id = frame
        message.pose.position.x, message.pose.position.y = x, y
        message.pose.orientation.w = 0.0  # any heading
        self.status.clear()
        self._goal.publish(message)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(60.0)
        future = client.call_async(request)
        self.wait(future.done)
        return future.result()


@pytest.fixture
def operator():
    rclpy.init()
    operator = Operator()
    yield operator
    operator.node.destroy_node()
    rclpy.try_shutdown()


def test_it_drives_to_goals_and_tells_what_it_does(run_node: Callable, operator: Operator) -> None:
    run_node("sim_bridge", "bridge", "task:=curved_corridor", "localisation:=noisy", "speed_factor:=4.0", "seed:=3")
    navigator = run_node("ctrl_rl_navigation", "navigator", "use_sim_time:=true")
    operator.wait_for(NavigatorStatus.WAITING, "waiting for a goal")

    operator.click(50.0, 0.0)
    refused = operator.wait_for(NavigatorStatus.UNREACHABLE)
    assert "off the map" in refused.message
    asked = operator.call(QueryValues, "navigator/query", QueryValues.Request(states=[0.5, 0.0]))
    assert not asked.success

    operator.click(*START_TO_GOAL)
    driving = operator.wait_for(NavigatorStatus.DRIVING)
    assert driving.header.frame_id == "map"
    assert (driving.goal.position.x, driving.goal.position.y) == START_TO_GOAL
    operator.wait(lambda: any(each.remaining_distance > 1.0 for each in operator.status))
    assert operator.status[-1].remaining_time > 5.0
    operator.wait(lambda: bool(operator.paths and operator.slices))
    last = operator.paths[-1].poses[-1].pose.position
    assert np.hypot(last.x - START_TO_GOAL[0], last.y - START_TO_GOAL[1]) < 0.2
    assert max(operator.slices[-1].data) == 100
    asked = operator.call(QueryValues, "navigator/query", QueryValues.Request(states=[*START_TO_GOAL, 0.5, 0.0]))
    assert asked.success
    assert asked.values[0] == pytest.approx(0.0, abs=0.5)
    assert asked.values[1] > 5.0
    assert operator.call(Trigger, "navigator/cancel", Trigger.Request()).success
    operator.wait_for(NavigatorStatus.CANCELLED)
    assert not operator.call(Trigger, "navigator/cancel", Trigger.Request()).success

    operator.click(*START_TO_GOAL)
    reached = operator.wait_for(NavigatorStatus.REACHED)
    assert reached.remaining_time == 0.0
    assert navigator.stop()[0] == 0
    assert "Traceback" not in navigator.output


def test_it_stands_without_a_pose_and_says_which_link_is_missing(run_node: Callable, operator: Operator) -> None:
    run_node("sim_bridge", "bridge", "task:=curved_corridor", "localisation:=none", "speed_factor:=4.0")
    navigator = run_node("ctrl_rl_navigation", "navigator", "use_sim_time:=true", "map:=maze")
    operator.click(1.0, 1.0, "nowhere")
    navigator.wait_for("the goal is refused: no transform from 'map' to 'nowhere'")
    operator.wait_for(NavigatorStatus.WAITING, "no transform from 'map' to 'base_footprint'")

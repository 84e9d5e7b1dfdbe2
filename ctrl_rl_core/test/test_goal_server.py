"""Action servers whose node ends the goals: errors, floods, cancels, and clients that ask late."""

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from ctrl_rl_core.ros import ActiveGoal, GoalError, GoalServer
from nav2_msgs.action import FollowPath
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor

from ctrl_rl_core import SuiteNode


class Walker(SuiteNode):
    """Keeps each goal until the test ends it; the goal's name of a controller says what goes wrong."""

    def __init__(self) -> None:
        super().__init__("walker")
        self.goals = list[ActiveGoal]()
        self.server = GoalServer(self, FollowPath, "walk", self.begin, ActiveGoal.cancelled)

    def begin(self, goal: ActiveGoal) -> None:
        self.goals.append(goal)
        if goal.request.controller_id == "refused":
            raise GoalError("no such way", 103)
        if goal.request.controller_id == "broken":
            raise ZeroDivisionError("a mistake")


class Pair:
    """A walker, and a client in another node."""

    def __init__(self) -> None:
        self.walker, self._node = Walker(), rclpy.create_node("client")
        self.client = ActionClient(self._node, FollowPath, "walk")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.walker)
        self._executor.add_node(self._node)
        self.heard = list[Any]()

    def done(self, future: Any) -> Any:
        self._executor.spin_until_future_complete(future, timeout_sec=30.0)
        assert future.done()
        return future.result()

    def spin_once(self) -> None:
        self._executor.spin_once(timeout_sec=0.1)

    def send(self, name: str = "") -> Any:
        return self.done(self.client.send_goal_async(FollowPath.Goal(controller_id=name), self.heard.append))

    def end(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self.walker.destroy_node()


@pytest.fixture
def pair() -> Iterator[Pair]:
    rclpy.init()
    pair = Pair()
    assert pair.client.wait_for_server(30.0)
    yield pair
    pair.end()
    rclpy.try_shutdown()


def test_the_node_ends_a_goal_when_it_likes(pair: Pair) -> None:
    handle = pair.send()
    (goal,) = pair.walker.goals
    result = handle.get_result_async()
    goal.feedback(speed=0.5)
    while not pair.heard:
        pair.spin_once()
    assert pair.heard[0].feedback.speed == 0.5
    assert not result.done()
    goal.succeed()
    goal.abort("too late", 1)
    goal.feedback(speed=1.0)
    assert pair.done(result).status == GoalStatus.STATUS_SUCCEEDED
    assert pair.done(handle.get_result_async()).status == GoalStatus.STATUS_SUCCEEDED  # asked again, later


def test_reasons_reach_the_client_and_mistakes_are_faults(pair: Pair) -> None:
    refused = pair.done(pair.send("refused").get_result_async())
    assert (refused.status, refused.result.error_code) == (GoalStatus.STATUS_ABORTED, 103)
    assert refused.result.error_msg == "no such way"
    assert pair.walker.faults.count == 0
    broken = pair.done(pair.send("broken").get_result_async())
    assert (broken.status, pair.walker.faults.count) == (GoalStatus.STATUS_ABORTED, 1)
    assert "a mistake" in broken.result.error_msg


def test_a_goal_is_cancelled_once(pair: Pair) -> None:
    handle = pair.send()
    assert len(pair.done(handle.cancel_goal_async()).goals_canceling) == 1
    assert pair.done(handle.get_result_async()).status == GoalStatus.STATUS_CANCELED
    assert len(pair.done(handle.cancel_goal_async()).goals_canceling) == 0


def test_results_are_kept_for_so_many_goals_and_no_more(pair: Pair) -> None:
    accepted = 0
    for _ in range(300):
        handle = pair.send()
        accepted += handle.accepted
        for goal in pair.walker.goals:
            goal.succeed()
        pair.walker.goals.clear()
    assert 256 <= accepted <= 300
    assert pair.walker.faults.count == 0


def test_clients_hear_that_the_node_ends(pair: Pair) -> None:
    result = pair.send().get_result_async()  # no executor takes the request any more
    pair.walker.server.destroy()
    assert (pair.done(result).status, result.result().result.error_msg) == (GoalStatus.STATUS_ABORTED, "the node ends")

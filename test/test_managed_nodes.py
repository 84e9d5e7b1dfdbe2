"""Driving nodes in the hands of a lifecycle manager: nothing moves unless it is active."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import TwistStamped
from lifecycle_msgs.srv import ChangeState, GetState
from nav2_client import ABORTED, Nav2Client, path_through, pose_at
from rclpy.node import Node

pytestmark = pytest.mark.realtime

CONFIGURE, CLEAN_UP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4
AFTER = {
    ("unconfigured", CONFIGURE): "inactive",
    ("inactive", CLEAN_UP): "unconfigured",
    ("inactive", ACTIVATE): "active",
    ("active", DEACTIVATE): "inactive",
}
SHUTDOWN = {"unconfigured": 5, "inactive": 6, "active": 7}
_IN_FLIGHT_S = 0.1
"""Until a command that was sent before a deactivation has arrived."""
_LISTENS_S = 0.05
"""Time after each transition in which nobody but active nodes may command: a period of the simulator's scans."""


class Manager:
    """Changes the states of one managed node, and hears what it commands."""

    def __init__(self, node: Node, name: str, topic: str) -> None:
        self._node, self.state = node, "unconfigured"
        self.heard: list[TwistStamped] = []
        node.create_subscription(TwistStamped, topic, self.heard.append, 100)
        self._change = node.create_client(ChangeState, f"{name}/change_state")
        self._get = node.create_client(GetState, f"{name}/get_state")
        assert self._change.wait_for_service(60.0)

    def change(self, transition: int) -> None:
        """Ask for a transition, possible or not, and compare the answer with the life of a managed node."""
        request = ChangeState.Request()
        request.transition.id = transition
        possible = (self.state, transition) in AFTER
        assert self._call(self._change, request).success == possible
        self.state = AFTER.get((self.state, transition), self.state)
        assert self._call(self._get, GetState.Request()).current_state.label == self.state

    def shut_down(self) -> None:
        request = ChangeState.Request()
        request.transition.id = SHUTDOWN[self.state]
        assert self._call(self._change, request).success
        assert self._call(self._get, GetState.Request()).current_state.label == "finalized"

    def moves(self) -> bool:
        return any(each.twist.linear.x or each.twist.angular.z for each in self.heard)

    def _call(self, client: Any, request: Any) -> Any:
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self._node, future, timeout_sec=30.0)
        assert future.done()
        return future.result()


def spin(node: Node, seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.01)


@pytest.fixture
def observer() -> Iterator[Node]:
    rclpy.init()
    node = rclpy.create_node("lifecycle_manager")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_a_stack_lives_through_200_random_transitions_and_moves_only_while_active(
    run_node: Callable, observer: Node
) -> None:
    run_node("sim_bridge", "bridge", "task:=curved_corridor", "speed_factor:=4.0")
    remap = ("cmd_vel:=cmd_vel_raw",)
    controller = run_node("koopman_lqr_controller", "controller", "managed:=true", "use_sim_time:=true", remap=remap)
    safety = run_node("ctrl_rl_safety", "safety_filter", "managed:=true", "use_sim_time:=true", "monitor:=false")
    nodes = [
        Manager(observer, "koopman_lqr_controller", "cmd_vel_raw"),
        Manager(observer, "safety_filter", "cmd_vel"),
    ]
    random, moved = np.random.default_rng(7), 0
    spin(observer, 2.0)
    assert not any(each.heard for each in nodes)  # nothing before the first activation
    for _ in range(200):
        node = nodes[random.integers(2)]
        possible = [change for state, change in AFTER if state == node.state]
        was_active = node.state == "active"
        node.change(int(random.choice(possible if random.random() < 0.8 else [1, 2, 3, 4])))
        if was_active and node.state != "active":
            spin(observer, _IN_FLIGHT_S)
        for each in nodes:
            each.heard.clear()
        spin(observer, _LISTENS_S)
        for each in nodes:
            assert each.state == "active" or not each.heard
        moved += all(each.state == "active" for each in nodes) and nodes[1].moves()
    assert moved > 5
    for each in nodes:
        each.shut_down()
    spin(observer, _IN_FLIGHT_S)
    assert not any(each.heard.clear() or each.heard for each in nodes)
    for process in (controller, safety):
        assert process.stop()[0] == 0
        assert "Traceback" not in process.output


@pytest.mark.parametrize(
    ("package", "executable", "words"),
    [
        ("ctrl_rl_navigation", "navigator", ()),
        ("ctrl_rl_core", "policy", ("policy:=corridor_doorways", "follow_path:=true", "pose:=tf")),
    ],
)
def test_a_managed_node_takes_goals_only_while_active_and_forgets_them(
    run_node: Callable, observer: Node, package: str, executable: str, words: tuple[str, ...]
) -> None:
    run_node("sim_bridge", "bridge", "task:=curved_corridor", "speed_factor:=2.0")
    node = run_node(package, executable, "managed:=true", "use_sim_time:=true", *words)
    manager, application = Manager(observer, executable, "cmd_vel"), Nav2Client()

    def send() -> bool:
        path = path_through((0.3, 0.0), (1.5, 0.0))
        return application.goToPose(pose_at(2.0, 1.2)) if executable == "navigator" else application.followPath(path)

    assert not send()  # rejected, as by Nav2
    manager.change(CONFIGURE)
    assert not send()
    manager.change(ACTIVATE)
    assert send()
    for _ in range(300):
        spin(observer, 0.1)
        if manager.moves():
            break
    assert manager.moves()
    manager.change(DEACTIVATE)
    application.wait()
    status, result = application.getResult()
    assert (status, result.error_msg) == (ABORTED, "the node is inactive")
    spin(observer, _IN_FLIGHT_S)
    last = manager.heard[-1].twist
    assert (last.linear.x, last.angular.z) == (0.0, 0.0)
    manager.heard.clear()
    manager.change(ACTIVATE)
    spin(observer, 2.0)
    assert not manager.moves()  # the old goal is forgotten
    assert node.stop()[0] == 0
    assert "Traceback" not in node.output
    application.destroy_node()

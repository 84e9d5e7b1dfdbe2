"""What the page's node passes on to others: goals, stops and policies, with the answers that visitors read."""

import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec

import pytest
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Bool

from ctrl_rl_core import find_robot

pytestmark = pytest.mark.skipif(find_spec("viser") is None, reason="viser is not installed: requirements/view.txt")


class Visitor:
    """Stands in the page's place: what it asks for, and what it is shown."""

    def __init__(self) -> None:
        self.frames, self.asks, self.scene = 0, [], None

    def take_requests(self) -> list:
        asks, self.asks = self.asks, []
        return asks

    def draw(self, scene: object) -> None:
        self.scene, self.frames = scene, self.frames + 1

    def close(self) -> None:
        pass

    def says(self) -> str:
        note = None if self.scene is None else self.scene.notes.get("page")
        return "" if note is None else note.text


@pytest.fixture
def place() -> Iterator[tuple[Visitor, Node, Callable]]:
    """Give a visitor, a node beside, and a function that spins all until a condition holds."""
    from ctrl_rl_bringup.view.live import ViewNode

    rclpy.init()
    visitor, beside, executor = Visitor(), rclpy.create_node("beside"), SingleThreadedExecutor()
    view = ViewNode(visitor, find_robot("turtlebot3_burger"))
    executor.add_node(view)
    executor.add_node(beside)

    def wait(fits: Callable[[], object]) -> None:
        deadline = time.monotonic() + 60.0
        while not fits():
            executor.spin_once(timeout_sec=0.05)
            assert time.monotonic() < deadline, visitor.says()

    yield visitor, beside, wait
    executor.shutdown()
    view.destroy_node()
    beside.destroy_node()
    rclpy.try_shutdown()


def test_a_visitor_hears_whether_somebody_listens(place: tuple[Visitor, Node, Callable]) -> None:
    from ctrl_rl_bringup.view.page import ReleaseStop, SendGoal, StopRobot

    visitor, beside, wait = place
    visitor.asks = [StopRobot()]
    wait(lambda: "nobody answers on" in visitor.says())
    visitor.asks = [SendGoal(1.0, 2.0)]
    wait(lambda: "reaches nobody" in visitor.says())

    goals: list[PoseStamped] = []
    stops: list[Bool] = []
    beside.create_subscription(PoseStamped, "goal_pose", goals.append, 10)
    beside.create_subscription(Bool, "emergency_stop", stops.append, 10)
    wait(lambda: beside.count_publishers("goal_pose") and beside.count_publishers("emergency_stop"))
    again = SendGoal(1.0, 2.0)
    wait(lambda: goals or (not visitor.asks and visitor.asks.append(again)))  # until both ends know of each other
    assert (goals[0].header.frame_id, goals[0].pose.position.x, goals[0].pose.position.y) == ("map", 1.0, 2.0)
    assert goals[0].pose.orientation.w == 0.0
    visitor.asks = [StopRobot()]
    wait(lambda: visitor.says() == "emergency stop")
    wait(lambda: [each.data for each in stops] == [True])
    visitor.asks = [ReleaseStop()]
    wait(lambda: [each.data for each in stops] == [True, False])
    assert visitor.says() == "emergency stop released"


def test_it_shows_commands_and_changes_the_policy(place: tuple[Visitor, Node, Callable], run_node: Callable) -> None:
    from ctrl_rl_bringup.view.page import UsePolicy

    visitor, beside, wait = place
    policy = run_node("ctrl_rl_core", "policy", "policy:=curved_corridor")
    publisher, command = beside.create_publisher(TwistStamped, "cmd_vel_raw", 1), TwistStamped()
    command.twist.linear.x = 0.2
    wait(lambda: publisher.publish(command) or (visitor.scene is not None and visitor.scene.raw == (0.2, 0.0)))
    wait(lambda: "/policy" in visitor.scene.notes)  # by its diagnostics
    for name, answer in (("quad_ttr", "is for a planar_quadrotor"), ("curved_corridor_edmd", "done")):
        visitor.asks = [UsePolicy(name)]
        wait(lambda name=name, answer=answer: f"policy {name}: " in visitor.says() and answer in visitor.says())
    policy.wait_for("policy curved_corridor_edmd.safetensors")

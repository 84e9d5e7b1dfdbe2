"""End of a drive: the end of the episode, or the distance limit set by the user."""

import time
from collections.abc import Callable

import pytest
from nav_msgs.msg import Odometry
from robot_side import PATIENCE_S, Robot, ask, corridor

from ctrl_rl_core import RESULT, SENSOR
from ctrl_rl_msgs.msg import EpisodeStatus, TaskOutcome
from ctrl_rl_msgs.srv import ResetWorld

pytestmark = pytest.mark.realtime

SECOND = 10**9


def test_the_robot_stands_when_the_episode_is_over_and_drives_in_the_next(robot: Robot, run_node: Callable) -> None:
    controller = run_node("koopman_lqr_controller", "controller", "scan_timeout:=5.0")
    episodes = robot.node.create_publisher(EpisodeStatus, "episode", RESULT)
    robot.wait_for_controller()
    assert ask(robot, corridor(0.1), SECOND).twist.linear.x > 0.0
    status = EpisodeStatus(episode=4)
    status.outcome.value = TaskOutcome.GOAL
    episodes.publish(status)
    assert robot.spin(PATIENCE_S, lambda: robot.commands[-1].twist.linear.x == 0.0), "without waiting for a scan"
    assert ask(robot, corridor(0.1), 2 * SECOND).twist.linear.x == 0.0
    controller.wait_for("the drive is over: goal reached (episode 4)")
    episodes.publish(EpisodeStatus(episode=5))
    robot.spin(0.5)
    assert ask(robot, corridor(0.1), 3 * SECOND).twist.linear.x > 0.0


def test_a_real_robot_stands_after_the_distance_that_it_may_drive(robot: Robot, run_node: Callable) -> None:
    controller = run_node("koopman_lqr_controller", "controller", "scan_timeout:=5.0", "max_distance:=0.15")
    robot.wait_for_controller()
    moving = Odometry()
    moving.twist.twist.linear.x = 0.2
    speeds = []
    for count in range(1, 7):
        robot.odom.publish(moving)
        robot.spin(0.1)
        robot.send(corridor(0.1 + 0.001 * count), count * SECOND // 5, odometry=False)
        stamp = count * SECOND // 5
        assert robot.spin(PATIENCE_S, lambda stamp=stamp: robot.answer_to(stamp) is not None)
        speeds.append(robot.answer_to(stamp).twist.linear.x)
    assert [speed > 0.0 for speed in speeds] == [True] * 4 + [False] * 2
    controller.wait_for("0.15 m driven (parameter max_distance; set it again to continue)")


def test_a_drive_without_the_demo_ends_at_the_goal_and_the_bridge_says_so_once(
    robot: Robot, run_node: Callable
) -> None:
    """The real bridge and the real controller, started manually."""
    truth: list[tuple[float, float, float]] = []
    ended: list[EpisodeStatus] = []

    def keep(message: Odometry) -> None:
        position = message.pose.pose.position
        truth.append((position.x, position.y, message.twist.twist.linear.x))

    robot.node.create_subscription(Odometry, "ground_truth", keep, SENSOR)
    robot.node.create_subscription(
        EpisodeStatus, "episode", lambda said: ended.append(said) if said.outcome.value else None, RESULT
    )
    for own in (robot.scan, robot.odom):  # there must be one lidar
        robot.node.destroy_publisher(own)
    bridge = run_node("sim_bridge", "bridge", "speed_factor:=4.0", "seed:=5")
    controller = run_node("koopman_lqr_controller", "controller", "use_sim_time:=true")
    deadline = time.monotonic() + 120.0
    while not ended:
        assert time.monotonic() < deadline, "it never arrives"
        robot.spin(0.1)
    assert ended[0].outcome.value == TaskOutcome.GOAL, controller.output
    assert robot.spin(PATIENCE_S, lambda: abs(truth[-1][2]) < 1e-3), "it drives on"
    place = truth[-1]
    robot.spin(2.0)
    assert truth[-1][:2] == pytest.approx(place[:2], abs=0.02), "it creeps on"
    assert bridge.output.count("episode 0: goal reached after") == 1
    again = robot.node.create_client(ResetWorld, "sim_bridge/reset")
    assert again.wait_for_service(10.0)
    again.call_async(ResetWorld.Request(seed=6))
    assert robot.spin(PATIENCE_S, lambda: truth[-1][2] > 0.05), "it does not drive in the next episode"

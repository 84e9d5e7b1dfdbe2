"""A drive has an end: the episode's, or the distance that the user allows."""

import time
from collections.abc import Callable

import pytest
from ctrl_rl_core.driving import ENDED
from ctrl_rl_core.driving.arrival import Arrival
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from robot_side import PATIENCE_S, Robot, ask, corridor

from ctrl_rl_core import RESULT, SENSOR, Outcome
from ctrl_rl_msgs.msg import EpisodeStatus, TaskOutcome
from ctrl_rl_msgs.srv import ResetWorld

pytestmark = pytest.mark.realtime

SECOND = 10**9


@given(st.lists(st.tuples(st.floats(0.0, 2.0), st.floats(-0.3, 0.3)), max_size=50), st.floats(0.05, 2.0))
def test_it_ends_when_the_distance_is_driven_and_not_before(steps: list[tuple[float, float]], limit: float) -> None:
    arrival, now, driven = Arrival(limit), 10.0, 0.0
    arrival.moved(now, 0.0)
    for step, speed in steps:
        before, now = now, now + step
        arrival.moved(now, speed)
        driven += abs(speed) * step if now - before <= 1.0 else 0.0
        assert arrival.travelled == pytest.approx(driven, abs=1e-6)
    assert bool(arrival.reason()) == (arrival.travelled >= limit)
    arrival.begin()
    assert not arrival.reason()


@pytest.mark.fault
def test_the_way_of_the_pose_counts_where_the_twist_is_zero() -> None:
    arrival = Arrival(0.3)
    for number in range(200):
        arrival.moved(0.1 * number, 1e-12)
        arrival.went(5.0 + 0.001 * (number % 2), 1.0)
    assert arrival.travelled < 1e-6, "a robot that stands drives nowhere in a little noise"
    for number in range(32):
        arrival.went(5.0, 1.0 + 0.01 * number)
    assert arrival.reason().startswith(f"{ENDED}0.3 m driven")
    arrival.begin()
    arrival.went(-90.0, 0.0)
    assert arrival.travelled == 0.0, "another origin is no way"


def test_numbers_that_make_no_sense_do_not_move_it() -> None:
    arrival = Arrival(1.0)
    for now, speed in ((0.0, 1e9), (0.5, float("nan")), (0.6, float("inf")), (float("nan"), 1.0), (-1e9, 1.0)):
        arrival.moved(now, speed)
    arrival.episode(3, 200)
    assert (arrival.travelled, arrival.reason()) == (0.0, "")


def test_a_new_episode_begins_a_new_drive() -> None:
    arrival = Arrival(0.0)
    assert [arrival.episode(0, outcome) or arrival.reason() for outcome in Outcome] == [
        "",
        f"{ENDED}goal reached (episode 0)",
        f"{ENDED}collision (episode 0)",
        f"{ENDED}trapped (episode 0)",
        f"{ENDED}time-out (episode 0)",
    ]
    arrival.episode(1, Outcome.RUNNING)
    assert not arrival.reason()


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
    controller.wait_for("0.15 m driven (parameter max_distance; set it anew to go on)")


def test_a_drive_without_the_demo_ends_at_the_goal_and_the_bridge_says_so_once(
    robot: Robot, run_node: Callable
) -> None:
    """The real bridge and the real controller, started by hand."""
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
    bridge = run_node("sim_bridge", "bridge", "speed_factor:=2.0", "seed:=5")
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

"""Applications written for Nav2 send the navigator poses, waypoints and paths, replace and cancel them."""

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from ctrl_rl_navigation.cli.simulation import TASK_NAME
from geometry_msgs.msg import PoseStamped, TwistStamped
from map_operator import write_room
from nav2_client import ABORTED, CANCELED, SUCCEEDED, Nav2Client, path_through, pose_at
from nav2_msgs.action import FollowWaypoints, NavigateToPose
from nav_msgs.msg import Odometry

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the map and the task of a room with a post at its centre."""
    return write_room(tmp_path_factory.mktemp("room")).parent


@pytest.fixture(scope="module")
def application(run_shared_node: Callable, room: Path) -> Iterator[Nav2Client]:
    """Run the simulator and the navigator, and give an application."""
    task = f"task:={room}/{TASK_NAME}.yaml"
    run_shared_node("sim_bridge", "bridge", task, "localisation:=noisy", "speed_factor:=4.0")
    words = (f"map:={room}/room.yaml", "use_sim_time:=true", "goal_heading_tolerance:=3.2", "goal_patience:=5.0")
    run_shared_node("ctrl_rl_navigation", "navigator", *words)
    rclpy.init()
    client = Nav2Client()
    client.odometry = []
    client.create_subscription(Odometry, "ground_truth", client.odometry.append, 10)
    yield client
    client.destroy_node()
    rclpy.try_shutdown()


def stands(client: Nav2Client) -> bool:
    """Return whether the robot comes to rest within a second."""
    for _ in range(200):
        client.odometry.clear()
        while not client.odometry:
            rclpy.spin_once(client, timeout_sec=0.1)
        twist = client.odometry[-1].twist.twist
        if abs(twist.linear.x) < 0.01 and abs(twist.angular.z) < 0.05:
            return True
    return False


def test_a_pose_with_feedback_and_result(application: Nav2Client) -> None:
    assert application.goToPose(pose_at(1.6, 0.5))
    application.wait()
    status, result = application.getResult()
    assert (status, result.error_code, result.error_msg) == (SUCCEEDED, 0, "")
    first, last = application.heard[0], application.heard[-1]
    assert first.distance_remaining > 0.8 > last.distance_remaining
    assert last.navigation_time.sec >= 3
    assert last.current_pose.header.frame_id == "map"
    assert np.hypot(last.current_pose.pose.position.x - 1.6, last.current_pose.pose.position.y - 0.5) < 0.4
    assert any(each.estimated_time_remaining.sec >= 2 for each in application.heard)


def test_a_new_goal_replaces_the_old_one_and_a_cancel_stops(application: Nav2Client) -> None:
    assert application.goToPose(pose_at(0.5, 1.8))
    application.wait(lambda: application.feedback is not None)
    old = application.result
    assert application.goToPose(pose_at(2.6, 1.8))
    application.wait(old.done)
    assert (old.result().status, old.result().result.error_msg) == (ABORTED, "another goal replaces this one")
    application.wait(lambda: len(application.heard) > 20)
    application.cancelTask()
    application.wait()
    assert application.getResult()[0] == CANCELED
    assert stands(application)


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (pose_at(50.0, 0.0), "off the map"),
        (pose_at(1.6, 1.05), "from an obstacle"),
        (pose_at(float("nan"), 0.5), "a translation of [nan"),
        (pose_at(1.0, 0.5, "nowhere"), "nowhere"),
        (pose_at(1.0, 0.5, w=0.0), "all zeros"),
        (pose_at(1.0, 0.5, w=0.2), "a quaternion of length 0.2"),
    ],
)
def test_what_is_no_goal_is_aborted_with_the_reason(application: Nav2Client, pose: object, words: str) -> None:
    assert application.goToPose(pose)
    application.wait()
    status, result = application.getResult()
    assert status == ABORTED
    assert words in result.error_msg
    assert 200 <= result.error_code <= 208
    assert stands(application)


def test_through_poses_it_passes_and_at_waypoints_it_stops(application: Nav2Client) -> None:
    places = [pose_at(0.5, 0.5), pose_at(1.6, 0.5), pose_at(2.6, 0.6)]
    assert application.goThroughPoses(places)
    application.wait()
    assert application.getResult()[0] == SUCCEEDED
    left = [each.number_of_poses_remaining for each in application.heard]
    assert left == sorted(left, reverse=True)
    assert set(left) >= {1, 2}
    assert application.followWaypoints([places[2], places[1], pose_at(50.0, 0.0)])
    application.wait()
    status, result = application.getResult()
    assert status == ABORTED
    assert [each.index for each in result.missed_waypoints] == [2]
    assert {each.current_waypoint for each in application.heard} >= {1}


def test_a_path_is_followed_and_bad_paths_are_not(application: Nav2Client) -> None:
    assert application.goToPose(pose_at(2.6, 0.5))
    application.wait()
    application.odometry.clear()
    # The long way round the post, first away from the goal.
    corners = ((2.6, 0.5), (2.6, 1.7), (0.6, 1.7), (0.6, 0.6), (1.5, 0.4))
    assert application.followPath(path_through(*corners))
    application.wait()
    status, result = application.getResult()
    assert (status, result.error_code) == (SUCCEEDED, 0)
    assert application.heard[0].distance_to_goal == pytest.approx(5.2, abs=0.8)
    assert max(each.speed for each in application.heard) > 0.15
    places = np.array([(each.pose.pose.position.x, each.pose.pose.position.y) for each in application.odometry])
    starts, ends = np.array(corners[:-1]), np.array(corners[1:])
    t = np.clip(((places[:, None] - starts) * (ends - starts)).sum(2) / ((ends - starts) ** 2).sum(1), 0.0, 1.0)
    errors = np.linalg.norm(places[:, None] - starts - t[..., None] * (ends - starts), axis=2).min(axis=1)
    assert errors.max() < 0.35
    assert errors.mean() < 0.12
    for path, code in (
        (path_through(), 103),
        (path_through((0.5, 0.5), (float("inf"), 0.5)), 103),
        (path_through((0.5, 0.5), (1.0, 0.5), frame="nowhere"), 102),
        (path_through((0.5, 0.5), (1.6, 1.05)), 103),
    ):
        assert application.followPath(path)
        application.wait()
        status, result = application.getResult()
        assert (status, result.error_code) == (ABORTED, code), result
        assert result.error_msg
        assert stands(application)


def test_a_path_that_is_planned_anew_each_second_does_not_stop_the_robot(application: Nav2Client) -> None:
    assert application.goToPose(pose_at(0.6, 0.5))
    application.wait()
    end, results = (0.6, 1.7), []
    ways = np.array(((0.6, 0.5), (2.6, 0.5), (2.6, 1.7), end))
    assert application.followPath(path_through(*ways))
    application.wait(lambda: bool(application.feedback and application.feedback.speed > 0.15))
    for _ in range(4):  # as Nav2's behaviour tree does
        results.append(application.result)
        assert application.followPath(path_through(*ways))
        application.wait(lambda: len(application.heard) > 10)
        stood = [each.speed < 0.02 for each in application.heard]
        assert sum(stood) < 10  # it turns at corners, and never waits
    application.wait()
    assert application.getResult()[0] == SUCCEEDED
    assert {each.result().status for each in results} == {ABORTED}
    place = application.odometry[-1].pose.pose.position
    assert np.hypot(place.x - end[0], place.y - end[1]) < 0.35


def test_waypoints_may_be_repeated_and_counts_are_checked(application: Nav2Client) -> None:
    here, there = pose_at(1.5, 0.5), pose_at(1.0, 0.5)
    assert application.send(FollowWaypoints, FollowWaypoints.Goal(poses=[there, here], number_of_loops=1))
    application.wait()
    assert application.getResult()[0] == SUCCEEDED
    visited = [each.current_waypoint for each in application.heard]
    assert np.flatnonzero(np.diff(visited)).size == 3
    for wrong in (
        FollowWaypoints.Goal(poses=[here], number_of_loops=2**32 - 1),
        FollowWaypoints.Goal(poses=[here], goal_index=2),
        FollowWaypoints.Goal(poses=[here], goal_index=1),
        FollowWaypoints.Goal(),
    ):
        assert application.send(FollowWaypoints, wrong)
        application.wait()
        assert application.getResult()[0] == ABORTED


def test_many_goals_at_once_end_in_the_last_one(application: Nav2Client) -> None:
    client = application.client_of(NavigateToPose)
    for _ in range(10):
        futures = [client.send_goal_async(NavigateToPose.Goal(pose=pose_at(0.5, 1.8))) for _ in range(5)]
        application.wait_for(lambda futures=futures: all(future.done() for future in futures))
        assert all(future.result().accepted for future in futures)
    assert application.goToPose(pose_at(1.5, 0.5))
    application.wait()
    assert application.getResult()[0] == SUCCEEDED


def test_a_goal_of_rviz_takes_over(application: Nav2Client) -> None:
    goals = application.create_publisher(PoseStamped, "goal_pose", 10)
    application.wait_for(lambda: goals.get_subscription_count() > 0)
    assert application.goToPose(pose_at(0.5, 1.8))
    application.wait(lambda: application.feedback is not None)
    goals.publish(pose_at(1.5, 0.5))
    application.wait()
    status, result = application.getResult()
    assert (status, result.error_msg) == (ABORTED, "a goal on goal_pose replaces this one")


@pytest.mark.usefixtures("application")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_navigator_that_ends_stops_the_robot_and_tells_its_client(
    room: Path, run_node: Callable, number: int
) -> None:
    parameters = (f"map:={room}/room.yaml", "use_sim_time:=true", "goal_heading_tolerance:=3.2")
    navigator = run_node(
        "ctrl_rl_navigation", "navigator", *parameters, remap=("__ns:=/other", "scan:=/scan", "odom:=/odom")
    )
    other = Nav2Client(f"application_{number}", namespace="other")
    commands = list[TwistStamped]()
    other.create_subscription(TwistStamped, "cmd_vel", commands.append, 10)
    assert other.goToPose(pose_at(0.5, 1.8))
    other.wait(lambda: any(each.twist.linear.x or each.twist.angular.z for each in commands))
    assert navigator.stop(number)[0] == 0
    other.wait()
    status, result = other.getResult()
    assert (status, result.error_msg) == (ABORTED, "the node ends")
    other.wait_for(lambda: commands[-1].twist.linear.x == commands[-1].twist.angular.z == 0.0)
    assert "Traceback" not in navigator.output
    other.destroy_node()

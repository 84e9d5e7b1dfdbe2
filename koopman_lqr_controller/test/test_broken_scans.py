"""The controller as a process with invalid scans and with obstacles: zero commands and a reported reason."""

import math
from collections.abc import Callable, Iterator
from itertools import count, islice

import numpy as np
import pytest
from ctrl_rl_core.ros import SCAN_PUBLISHER, to_stamp
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from robot_side import PATIENCE_S, Robot, answered, ask, corridor
from sensor_msgs.msg import LaserScan
from test_controller_guards import diagnosed

BOTH = ("curved_corridor", "curved_corridor_edmd")
LEARNT = BOTH[:1]
STAMPS = count(1)
"""Stamps of scans: the tests share a controller, so each scan needs a new one."""


@pytest.fixture(scope="module")
def robot(request: pytest.FixtureRequest, run_shared_node: Callable) -> Iterator[Robot]:
    """Return the robot of a controller with this policy; the region guard is off, since only scans are tested."""
    robot = Robot()
    policy = f"policy:={request.param}"
    node = run_shared_node("koopman_lqr_controller", "controller", policy, "scan_timeout:=5.0", "largest_distance:=0.0")
    robot.wait_for_controller()
    yield robot
    node.end()
    robot.close()


def half_covered() -> np.ndarray:
    return np.where(np.arange(360) < 180, 0.0, corridor(0.0))


@pytest.mark.fault
@pytest.mark.parametrize(
    ("ranges", "reason"),
    [
        (np.zeros(360), "0 % of the scan's beams have an echo"),
        (np.full(360, np.inf), "0 % of the scan's beams have an echo"),
        (half_covered(), "no echoes within 120 deg ahead"),
        (np.ones(30_000), "scan with 30000 ranges"),
    ],
    ids=["all zero", "all infinite", "half zero", "too many beams"],
)
@pytest.mark.parametrize("robot", BOTH, indirect=True)
def test_it_stands_on_a_broken_scan_says_why_and_goes_on_with_the_next_good_one(
    robot: Robot, ranges: np.ndarray, reason: str
) -> None:
    assert ask(robot, corridor(0.0), next(STAMPS)).twist.linear.x > 0.0
    for stamp in (next(STAMPS), next(STAMPS)):
        twist = ask(robot, ranges, stamp).twist
        assert (twist.linear.x, twist.angular.z) == (0.0, 0.0)
        assert reason in robot.thought_of(stamp).stop
    assert diagnosed(robot, reason).level == DiagnosticStatus.WARN
    assert ask(robot, corridor(0.0), next(STAMPS)).twist.linear.x > 0.0


@pytest.mark.fault
@pytest.mark.parametrize("robot", BOTH, indirect=True)
def test_a_wall_ahead_stops_it_whatever_the_policy_wants(robot: Robot) -> None:
    """Without the region guard, only the obstacle stop remains."""
    stamp = next(STAMPS)
    bearing = np.arange(360) * 2 * np.pi / 360
    wall = np.where(np.cos(bearing) > 0, 0.17 / np.maximum(np.cos(bearing), 1e-6), np.inf)
    assert ask(robot, np.minimum(corridor(0.0), wall), stamp).twist.linear.x <= 0.0
    if robot.thought_of(stamp).stop:
        assert "obstacle" in robot.thought_of(stamp).stop
        diagnosed(robot, "ahead")
    assert ask(robot, corridor(0.0), next(STAMPS)).twist.linear.x > 0.0


@pytest.mark.fault
@pytest.mark.parametrize("robot", LEARNT, indirect=True)
def test_a_frozen_lidar_stops_a_robot_that_moves(robot: Robot) -> None:
    moving = Odometry(child_frame_id="robot1/base_link")
    moving.twist.twist.linear.x = 0.2
    ask(robot, corridor(0.05), next(STAMPS))
    moves = []
    for stamp in islice(STAMPS, 5):
        robot.odom.publish(moving)
        robot.spin(0.1)
        robot.send(corridor(0.0), stamp, odometry=False)
        assert robot.spin(PATIENCE_S, lambda stamp=stamp: answered(robot, stamp))
        answer = robot.answer_to(stamp)
        assert answer is not None
        assert answer.header.frame_id == "robot1/base_link"
        moves.append(answer.twist.linear.x > 0.0)
    assert moves[0]
    assert moves[-2:] == [False, False]
    assert "lidar frozen" in robot.thought_of(stamp).stop


@pytest.mark.fault
@pytest.mark.parametrize("robot", LEARNT, indirect=True)
def test_a_second_lidar_on_the_topic_stops_it(robot: Robot) -> None:
    ask(robot, corridor(0.05), next(STAMPS))  # no lidar that was frozen before
    assert ask(robot, corridor(0.0), next(STAMPS)).twist.linear.x > 0.0
    other = robot.node.create_publisher(LaserScan, "scan", SCAN_PUBLISHER)

    def stopped(words: str) -> bool:
        stamp = next(STAMPS)
        ask(robot, corridor(0.0), stamp)
        return words in robot.thought_of(stamp).stop

    for _ in range(100):
        if stopped("2 publishers on /scan"):
            break
    else:
        raise AssertionError(robot.latents[-1].stop)
    robot.node.destroy_publisher(other)
    for _ in range(100):
        if not stopped("publishers"):
            break
    else:
        raise AssertionError("it stands though one lidar is left")
    last = next(STAMPS)
    scan = LaserScan(
        angle_max=2 * math.pi * 359 / 360, angle_increment=2 * math.pi / 360, range_min=0.12, range_max=3.5
    )
    scan.header.frame_id, scan.header.stamp = "another", to_stamp(last)
    scan.ranges = corridor(0.0).tolist()
    robot.scan.publish(scan)
    assert "scans of two lidars" in robot.thought_of(last).stop

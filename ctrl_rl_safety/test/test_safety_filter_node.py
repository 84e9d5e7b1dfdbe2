"""The filter as a real node with a real watchdog: commands pass; walls and every fault stop the robot."""

import math
import signal
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from ctrl_rl_core.ros import float32_array
from room import Room, shifted

from ctrl_rl_msgs.msg import SafetyStatus
from ctrl_rl_safety import ROBOTS

RADIUS = ROBOTS["turtlebot3_burger"].radius
pytestmark = pytest.mark.usefixtures("_no_shared_memory")  # some are killed or frozen


@pytest.fixture(scope="module")
def room() -> Iterator[Room]:
    rclpy.init()
    out = Room()
    yield out
    out.node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture(scope="module")
def start_filter(run_shared_node: Callable[..., Any]) -> Callable[[], Any]:
    return lambda: run_shared_node(
        "ctrl_rl_safety",
        "safety_filter",
        "lidar_x:=0.0",
        "scan_timeout:=0.4",
        "raw_timeout:=0.4",
        "unblock_after:=0.0",
        remap=("cmd_vel:=cmd_vel_safe",),
    )


@pytest.fixture(scope="module")
def chain(start_filter: Callable[[], Any], run_shared_node: Callable[..., Any], room: Room) -> Any:
    """Return the filter, once commands pass through it and the watchdog."""
    run_shared_node("ctrl_rl_core", "watchdog", "timeout:=0.4", remap=("cmd_vel_raw:=cmd_vel_safe",))
    node = start_filter()
    room.raw = (0.0, 0.3)
    room.until(lambda: room.command == room.raw)
    return node


@pytest.mark.usefixtures("chain")
def test_commands_pass_untouched_and_the_pictures_come(room: Room) -> None:
    passed = room.until_told(SafetyStatus.PASSED)
    assert (passed.raw_speed, passed.raw_turn_rate) == (passed.speed, passed.turn_rate) == (0.0, 0.3)
    assert passed.header.frame_id == "odom"
    assert passed.margin > 0.0
    room.until(lambda: bool(room.sets and room.escapes))
    picture = room.sets[-1]
    assert picture.header.frame_id == "odom"
    assert {0, 100} <= set(picture.data)


@pytest.mark.usefixtures("chain")
def test_a_wall_stops_the_robot_before_it_is_touched_and_the_newest_command_counts(room: Room) -> None:
    room.raw = (0.22, 0.0)
    corrected = room.until_told(SafetyStatus.CORRECTED)
    assert corrected.speed < corrected.raw_speed
    assert "no certified escape" in corrected.why
    room.until(lambda: room.command[0] == pytest.approx(0.0, abs=0.01))
    assert RADIUS < room.gap < RADIUS + 0.15
    for _ in range(2000):
        room.send_raw(-0.1, 0.0)
    room.raw = (-0.07, 0.0)
    room.until(lambda: room.command == room.raw)
    room.until(lambda: room.gap > 0.4)


def no_echo(scan: Any) -> Any:
    scan.ranges = float32_array(np.full(len(scan.ranges), math.nan))
    return scan


def half(scan: Any) -> Any:
    scan.ranges = scan.ranges[::2]
    return scan


def huge(scan: Any) -> Any:
    scan.ranges = float32_array(np.ones(30_000))
    return scan


def nowhere(odometry: Any) -> Any:
    odometry.pose.pose.position.x = math.nan
    return odometry


def too_fast(odometry: Any) -> Any:
    odometry.twist.twist.linear.x = math.inf
    return odometry


@pytest.mark.parametrize(
    ("name", "fault", "why"),
    [
        ("scan", no_echo, "only 0 % of the scan's beams"),
        ("scan", half, "the scan has 90 ranges"),
        ("scan", huge, "scan with 30000 ranges"),
        ("scan", lambda scan: shifted(scan, -1.0), "scan is 1.0"),
        ("scan", lambda scan: shifted(scan, 1.0), "ahead of this clock"),
        ("scan", lambda _: None, "no recent scan"),
        ("odometry", lambda odometry: shifted(odometry, -5.0), "odometry is 5.0"),
        ("odometry", lambda odometry: shifted(odometry, 5.0), "ahead of this clock"),
        ("odometry", nowhere, "a translation of [nan"),
        ("odometry", too_fast, "odometry with speed inf"),
        ("odometry", lambda _: None, "no recent odometry"),
        ("raw", (math.nan, 0.0), "raw command of nan"),
        ("raw", None, "no recent command on /cmd_vel_raw"),
    ],
)
def test_it_stands_while_it_does_not_know_and_goes_on_afterwards(
    chain: Any, room: Room, name: str, fault: Any, why: str
) -> None:
    before, going = getattr(room, name), (0.0, 0.3)
    room.raw = going
    room.until(lambda: room.command == going)
    setattr(room, name, fault)
    room.until(lambda: bool(room.told) and why in room.told[-1].why)
    room.until(lambda: room.command == (0.0, 0.0))
    setattr(room, name, before if name != "raw" else going)
    room.until(lambda: room.command == going)
    assert "callback failed" not in chain.output


@pytest.mark.usefixtures("chain")
def test_after_a_jump_of_the_odometry_it_waits_for_a_scan_and_goes_on(room: Room) -> None:
    def moved(odometry: Any) -> Any:
        odometry.pose.pose.position.x += 5.0
        return odometry

    before, scan = room.odometry, room.scan
    room.raw = (0.0, 0.3)
    room.until(lambda: room.command == room.raw)
    room.odometry, room.scan = moved, lambda _: None
    room.until_told(SafetyStatus.WAITING, "waiting for a scan")
    room.scan = scan
    room.until_told(SafetyStatus.PASSED)
    room.odometry = before
    room.until_told(SafetyStatus.PASSED)


@pytest.mark.usefixtures("chain")
def test_a_robot_that_moves_although_it_is_told_to_stand_is_not_driven_until_it_stands(room: Room) -> None:
    def pushed(odometry: Any) -> Any:
        odometry.twist.twist.linear.x += 0.1
        return odometry

    before, room.raw = room.odometry, (0.0, 0.0)
    room.told.clear()
    room.until(lambda: len(room.told) > 60)
    room.odometry = pushed
    room.until_told(SafetyStatus.WAITING, "although it is told to stand")
    room.odometry, room.raw = before, (0.0, 0.3)
    room.until(lambda: room.command == room.raw)


def test_the_watchdog_stops_the_robot_of_a_killed_filter_and_a_new_one_ends_with_a_zero(
    chain: Any, start_filter: Callable[[], Any], room: Room
) -> None:
    chain.stop(signal.SIGKILL)
    room.until(lambda: room.command == (0.0, 0.0))
    again = start_filter()
    room.until(lambda: room.command == (0.0, 0.3))
    room.commands.clear()
    code, _ = again.stop(signal.SIGTERM)
    assert code == 0
    room.until(lambda: room.commands[-1:] == [(0.0, 0.0)])
    assert "Traceback" not in again.output


def test_a_robot_that_answers_later_than_its_model_says_is_driven_with_that_delay(
    start_filter: Callable[[], Any], room: Room
) -> None:
    room.raw, room.late = (0.0, 0.0), 0.4
    node = start_filter()
    room.until_told(SafetyStatus.PASSED)
    room.raw = (0.0, 0.5)
    told = room.until_told(SafetyStatus.PASSED, "delay")
    assert "the robot is not as its model says: delay" in told.why
    room.late = 0.0
    assert node.stop(signal.SIGTERM)[0] == 0
    assert "Traceback" not in node.output

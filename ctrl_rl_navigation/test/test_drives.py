"""The navigator drives a simulated burger to goals and past unmapped obstacles, and never where it must not."""

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_navigation.cli.simulation import Drive, DriveSimulation, Errors
from ctrl_rl_navigation.driving.decision import Decision, Goal, NavigatorOptions, NavigatorState
from ctrl_rl_navigation.driving.navigator import Navigator
from ctrl_rl_navigation.robot import limits_of

from ctrl_rl_core import OccupancyMap, find_robot

NONE = np.empty((0, 2))
BURGER = limits_of(find_robot("turtlebot3_burger"))


def room(*blocks: tuple[slice, slice]) -> OccupancyMap:
    """Return a room of 3 m by 2 m with blocks in it."""
    cells = np.zeros((44, 64), np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 100, 100, 100, 100
    for block in blocks:
        cells[block] = 100
    return OccupancyMap(cells, 0.05)


POST = (slice(17, 25), slice(28, 36))
DOOR_CLOSED = (slice(0, 44), slice(30, 32))


def drive_between(
    world: OccupancyMap, known: OccupancyMap, errors: Errors, folder: Path
) -> tuple[DriveSimulation, Drive]:
    world.save(folder / "world.yaml")
    simulation = DriveSimulation(folder / "world.yaml", np.array((0.5, 1.05, 2.0)), 1, errors)
    simulation.navigator.set_map(known)
    return simulation, simulation.drive(Goal((2.7, 1.05)), 60.0)


def test_it_reaches_the_goal_round_an_obstacle_with_drift_and_an_error_of_the_pose(tmp_path: Path) -> None:
    simulation, drive = drive_between(room(POST), room(POST), Errors(), tmp_path)
    simulation.close()
    assert drive.state is NavigatorState.REACHED
    assert not drive.collided
    assert drive.distance < 0.35
    assert drive.seconds < 1.6 * 2.1 / BURGER.speed


def test_it_goes_round_an_obstacle_that_the_map_has_not(tmp_path: Path) -> None:
    simulation, drive = drive_between(room(POST), room(), Errors(), tmp_path)
    simulation.close()
    assert (drive.state, drive.collided) == (NavigatorState.REACHED, False)
    assert drive.solves > 1


def test_it_stands_where_an_obstacle_closes_the_only_way_and_says_so(tmp_path: Path) -> None:
    simulation, drive = drive_between(room(DOOR_CLOSED), room(), Errors(position=1e-3, heading=1e-3), tmp_path)
    simulation.close()
    assert drive.state is NavigatorState.BLOCKED
    assert not drive.collided
    assert drive.waited > 20.0


def test_without_a_way_on_the_map_it_says_so_at_once_and_does_not_move(tmp_path: Path) -> None:
    simulation, drive = drive_between(room(DOOR_CLOSED), room(DOOR_CLOSED), Errors(), tmp_path)
    simulation.close()
    assert drive.state is NavigatorState.UNREACHABLE
    assert drive.seconds < 0.5


def test_it_reaches_a_goal_that_is_nearer_to_a_wall_than_it_may_come(tmp_path: Path) -> None:
    room().save(tmp_path / "world.yaml")
    simulation = DriveSimulation(tmp_path / "world.yaml", (0.7, 1.0, 0.0), 1, Errors(1e-6, 1e-6, 1e-6))
    drive = simulation.drive(Goal((0.17, 1.15)), 20.0)
    simulation.close()
    assert (drive.state, drive.collided) == (NavigatorState.REACHED, False)
    assert drive.distance < NavigatorOptions().tolerance + 0.01
    assert drive.seconds < 8.0  # without waiting for what does not come


def test_where_obstacles_let_it_come_no_nearer_it_arrives_a_bit_farther_away(navigator: Navigator) -> None:
    pose, around = np.array((1.0, 1.0, 0.0)), np.column_stack((np.full(9, 0.17), np.linspace(-0.1, 0.1, 9)))
    navigator.set_goal(Goal((1.2, 1.0)))
    for now in np.arange(0.0, 6.0, 0.1):
        assert navigator.decide(now, pose, around).state is NavigatorState.DRIVING
    reached = [navigator.decide(now, pose, around) for now in np.arange(6.0, 6.4, 0.1)][-1]
    assert reached.state is NavigatorState.REACHED
    assert reached.message == "reached to 0.20 m: obstacles let the robot come no nearer"


@pytest.fixture
def navigator() -> Navigator:
    navigator = Navigator(BURGER, NavigatorOptions(inline=True))
    navigator.set_map(room())
    navigator.poll(0.0)
    return navigator


def test_it_waits_for_what_it_lacks_and_stands_off_the_map(navigator: Navigator) -> None:
    pose = np.array((1.0, 1.0, 0.0))
    assert Navigator(BURGER).decide(0.0, pose, NONE).message == "waiting for a map"
    assert navigator.decide(0.0, pose, NONE).message == "waiting for a goal"
    navigator.set_goal(Goal((2.5, 1.0)))
    assert navigator.decide(0.1, pose, NONE).state is NavigatorState.DRIVING
    outside = navigator.decide(0.2, np.array((-3.0, 1.0, 0.0)), NONE)
    assert (outside.state, outside.command.tolist()) == (NavigatorState.WAITING, [0.0, 0.0])
    assert "off the map" in outside.message
    assert navigator.decide(0.3, pose, NONE).state is NavigatorState.DRIVING


def test_goals_are_cancelled_and_replaced(navigator: Navigator) -> None:
    pose = np.array((1.0, 1.0, 0.0))
    assert not navigator.cancel()
    navigator.set_goal(Goal((2.5, 1.0)))
    assert navigator.decide(0.0, pose, NONE).command[0] > 0.0
    assert navigator.remaining_distance == pytest.approx(1.5, abs=0.15)
    navigator.set_goal(Goal((0.3, 1.0)))
    behind = navigator.decide(0.1, pose, NONE)
    assert abs(behind.command[1]) > 0.3
    assert behind.remaining_time == pytest.approx(0.7 / 0.22 + math.pi / 2.0, abs=1.5)
    assert navigator.cancel()
    assert navigator.decide(0.2, pose, NONE).state is NavigatorState.CANCELLED
    navigator.set_goal(Goal((9.0, 1.0)))
    refused = navigator.decide(0.3, pose, NONE)
    assert (refused.state, refused.message) == (
        NavigatorState.UNREACHABLE,
        "the goal (9.00, 1.00) lies off the map",
    )
    navigator.set_goal(Goal((1.05, 1.0), heading=math.pi / 2.0))
    turning = navigator.decide(0.4, pose, NONE)
    assert turning.command[0] == 0.0
    assert turning.command[1] > 0.0
    assert navigator.decide(0.5, np.array((1.0, 1.0, 1.5)), NONE).state is NavigatorState.REACHED


def decide_until(navigator: Navigator, pose: np.ndarray, done: Callable[[], bool]) -> Decision:
    deadline = time.monotonic() + 60.0
    while not done():
        assert time.monotonic() < deadline
        decision = navigator.decide(0.0, pose, NONE)
    return decision


def test_a_solve_in_the_background_leaves_the_old_goal_until_it_is_ready() -> None:
    navigator = Navigator(BURGER)
    navigator.set_map(room())
    pose = np.array((1.0, 1.0, 0.0))
    navigator.set_goal(Goal((2.5, 1.0)))
    assert decide_until(navigator, pose, lambda: navigator.goal is not None).state is NavigatorState.DRIVING
    first = navigator.goal
    navigator.set_goal(Goal((2.5, 0.5)))
    assert navigator.goal is first
    decide_until(navigator, pose, lambda: navigator.goal is not first)
    assert navigator.goal == Goal((2.5, 0.5))


def test_obstacles_of_the_scan_fade_and_are_seen_through(navigator: Navigator) -> None:
    layer, pose = navigator.layer, np.array((0.5, 1.0, 0.0))
    assert layer is not None
    bearings = np.radians(np.arange(360))
    ring = np.column_stack((np.cos(bearings), np.sin(bearings)))
    navigator.see(0.0, pose, 0.4 * ring[:10])
    count = len(layer)
    assert count > 0
    assert np.linalg.norm(layer.points() - pose[:2], axis=1) == pytest.approx(0.4, abs=0.04)
    navigator.see(1.0, pose, NONE)
    assert len(layer) == count  # nothing is known there
    navigator.see(2.0, pose, np.column_stack((np.full(20, 2.4), np.linspace(-0.5, 1.0, 20)))[:0])
    navigator.see(20.0, pose, NONE)
    assert len(layer) == 0
    navigator.see(21.0, pose, 0.4 * ring[:10])
    navigator.see(21.2, pose, 2.0 * np.r_[ring[-20:], ring[:30]])
    assert all(math.dist(point, pose[:2]) > 1.0 for point in layer.points())

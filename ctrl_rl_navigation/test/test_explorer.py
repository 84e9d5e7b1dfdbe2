"""Components of the explorer: a map from scans, moving echoes, and roll-outs of a rectangular robot."""

import math
from dataclasses import replace

import numpy as np
import pytest
from ctrl_rl_navigation.driving.explorer import Explorer, ExplorerOptions, StuckWatch
from ctrl_rl_navigation.driving.look_ahead import REVERSING, TURNS_AFTER, Choice, LookAhead
from ctrl_rl_navigation.driving.scan_map import ScanMap
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.values.map_solver import MapSolver

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation import DriveLimits

LONG = DriveLimits(1.0, 2.0, 3.0, 8.0, 0.35, 0.03, 0.6, 0.3)
"""A robot twice as long as wide."""
OPTIONS = ExplorerOptions()


def look(*posts: tuple[float, float], origin: tuple[float, float] = (0.0, 0.0), radius: float = 0.2) -> tuple:
    """Return the lidar's position, beam ends and echoes of a scan of round posts, up to 5 m."""
    bearings = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    ranges = np.full(720, 5.0)
    rays = np.column_stack((np.cos(bearings), np.sin(bearings)))
    for x, y in posts:
        along = rays @ (x - origin[0], y - origin[1])
        aside = np.abs(rays @ (-(y - origin[1]), x - origin[0]))
        meets = (aside < radius) & (along > 0.0)
        ranges[meets] = np.minimum(ranges[meets], along[meets] - np.sqrt(radius**2 - aside[meets] ** 2))
    return np.array(origin), origin + rays * ranges[:, None], ranges < 5.0


def test_a_map_grows_from_scans_and_forgets_what_beams_go_through() -> None:
    corners = np.array(((0.0, 0.0), (3.0, 0.0)))
    map_ = ScanMap(corners, 1.0, 0.05)
    assert not map_.occupancy().cells.any()
    map_.see(*look((2.0, 0.0)))
    row, column = map_.occupancy().world_to_cell(np.array((1.8, 0.0)))
    assert map_.occupancy().cells[row, column] == 100
    assert len(map_.points_near(np.array((1.8, 0.0)), 0.5)) == np.count_nonzero(map_.occupancy().cells)
    assert len(map_.points_near(np.array((50.0, 0.0)), 0.5)) == 0
    for _ in range(20):
        map_.see(*look())
    assert not map_.occupancy().cells.any()


def posts_beside_a_gap(width: float) -> np.ndarray:
    """Return echoes of two walls across the path, 1 m ahead, with a gap between them."""
    along = np.linspace(0.5 * width, 3.0, 100)
    ys = np.concatenate((along, -along))
    return np.column_stack((np.full(len(ys), 1.0), ys))


def expected_time(limits: DriveLimits, gap: float) -> float:
    """Return a look-ahead's expected time to a goal behind a gap."""
    empty = OccupancyMap(np.zeros((80, 160), np.int8), 0.05, (-2.0, -2.0, 0.0))
    value = MapSolver(empty, limits).solve((4.0, 0.0), 0.3)
    ahead = LookAhead(limits, OPTIONS.period, OPTIONS.delay, OPTIONS.deceleration, OPTIONS.step, 2.5, 0.05)
    return ahead.choose(value, np.zeros(3), np.array((0.5, 0.0)), posts_beside_a_gap(gap)).cost


def test_a_long_robot_fits_through_a_gap_that_a_disc_around_it_does_not() -> None:
    disc = DriveLimits(1.0, 2.0, 3.0, 8.0, 0.35, 0.03)
    assert expected_time(LONG, 0.5) < expected_time(disc, 0.5) - 0.5
    assert expected_time(LONG, 0.3) > expected_time(LONG, 0.5) + 0.5


def test_a_length_needs_a_width() -> None:
    with pytest.raises(NavigationError, match="width"):
        replace(LONG, length=0.5, width=0.0)


@pytest.mark.parametrize(
    ("motion", "post"),
    [((-0.5, 0.0), (-0.345, 0.0)), ((0.0, 2.0), (0.24, 0.2)), ((0.5, 0.0), (0.345, 0.0))],
)
def test_it_stops_where_going_on_would_touch_a_post(motion: tuple[float, float], post: tuple[float, float]) -> None:
    empty = OccupancyMap(np.zeros((120, 120), np.int8), 0.05, (-3.0, -3.0, 0.0))
    value = MapSolver(empty, LONG).solve((0.0, 2.5), 0.3)
    ahead = LookAhead(LONG, 0.05, 0.1, 3.0, 0.05, 1.2, 0.1)
    choice = ahead.choose(value, np.zeros(3), np.array(motion), np.array((post,)))
    assert choice.cost == math.inf
    assert choice.command[0] == 0.0
    assert abs(choice.command[1]) < max(abs(motion[1]), 1e-9)


def test_a_plan_goes_on_and_ends_with_what_follows_it() -> None:
    ahead = LookAhead(LONG, 0.05, 0.1, 3.0, turns_after=(0.0, 0.5))
    rest = ahead._rest(np.array((0.3, 1.0, 0.2, 0.5)))
    np.testing.assert_allclose(rest, (0.3, 1.0, 0.15, 0.5))
    np.testing.assert_allclose(ahead._rest(np.array((0.3, 1.0, 0.05, 0.5)))[:2], (1.0, 0.5))


def test_it_explores_round_a_post_to_the_goal() -> None:
    explorer = Explorer(LONG, np.zeros(3), (3.0, 0.0))
    pose, command, now, nearest = np.zeros(3), np.zeros(2), 0.0, math.inf
    assert not explorer.decide(0.0, pose).any()
    while math.dist(pose[:2], (3.0, 0.0)) > OPTIONS.tolerance:
        assert now < 12.0
        explorer.see(now, *look((1.5, 0.05), origin=(pose[0], pose[1])))
        command = explorer.decide(now, pose)
        explorer.sent(command)
        pose = pose + 0.05 * np.array((command[0] * math.cos(pose[2]), command[0] * math.sin(pose[2]), command[1]))
        nearest = min(nearest, math.dist(pose[:2], (1.5, 0.05)))
        now += 0.05
    assert nearest > 0.2 + 0.5 * LONG.width
    assert not explorer.decide(now, pose).any()


def test_a_robot_that_stays_about_a_place_is_stuck_until_it_has_left_it() -> None:
    watch = StuckWatch()
    poses = [(0.0, 0.0), (0.9, 0.05), (1.1, 0.05), (1.2, 0.3), (1.3, 0.6), (1.4, 0.6), (2.5, 0.6)]
    said = [watch.stuck(now, np.array((x, 0.0, 0.0))) for now, x in poses]
    assert said == [False, False, True, True, False, False, True]


def test_a_robot_that_turns_on_the_spot_is_not_stuck() -> None:
    watch = StuckWatch()
    assert not any(watch.stuck(0.1 * k, np.array((0.0, 0.0, 0.1 * k))) for k in range(50))


def test_a_stuck_robot_puts_nothing_off() -> None:
    empty = OccupancyMap(np.zeros((160, 160), np.int8), 0.05, (-4.0, -4.0, 0.0))
    value = MapSolver(empty, LONG).solve((-3.0, 0.0), 0.3)
    ahead = LookAhead(LONG, 0.05, 0.1, 3.0, 0.05, 1.2, turns_after=TURNS_AFTER, speeds=REVERSING)
    random, waited = np.random.default_rng(0), 0

    def choose(posts: np.ndarray) -> tuple[Choice, Choice]:
        free, stuck = (ahead.choose(value, np.zeros(3), np.zeros(2), posts, None, each) for each in (False, True))
        return free, stuck

    for _ in range(30):
        away, bearing = random.uniform(0.35, 1.2, 6), random.uniform(-math.pi, math.pi, 6)
        free, stuck = choose(np.column_stack((away * np.cos(bearing), away * np.sin(bearing))))
        waited += free.plan[0] == 0.0
        assert stuck.plan[0] != 0.0
        assert free.cost <= stuck.cost < math.inf
    assert waited > 0, "none of them told the two apart"
    free, stuck = choose(np.array(((0.345, 0.0), (-0.345, 0.0))))
    assert stuck.cost == free.cost < math.inf, "where no way is free it still turns on the spot"
    assert stuck.command[1] != 0.0

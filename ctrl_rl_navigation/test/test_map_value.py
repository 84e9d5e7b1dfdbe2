"""The time to reach on a map against closed-form geometry."""

import math
from dataclasses import replace

import numpy as np
import pytest
from ctrl_rl_navigation.maps import load_map, map_names
from ctrl_rl_navigation.robot import limits_of
from ctrl_rl_navigation.values.map_solver import CancelledError, MapSolver
from ctrl_rl_navigation.values.map_value import path_length
from generated_maps import MAPS, make_map

from ctrl_rl_core import OccupancyMap, find_robot
from ctrl_rl_navigation import NavigationError

LIMITS = limits_of(find_robot("turtlebot3_burger"))
RADIUS = 0.1


@pytest.fixture(scope="module")
def two_rooms() -> OccupancyMap:
    """Two rooms of 3 m by 4 m; the wall between them ends 1 m below the upper one, and the right one has a closet."""
    cells = np.zeros((80, 122), np.int8)
    cells[:60, 60:62] = 100
    cells[20:22, 100:], cells[:20, 100:102] = 100, 100
    return OccupancyMap(cells, 0.05, (-1.0, 2.0, 0.3))


def test_in_the_open_the_time_is_the_distance() -> None:
    field = OccupancyMap(np.zeros((200, 300), np.int8), 0.05, (-3.0, 1.0, 0.5))
    goal = tuple(field.cell_to_world(80.3, 110.7))
    value = MapSolver(field, LIMITS, slowest=1.0).solve(goal, RADIUS)
    rows, columns = np.random.default_rng(0).uniform((5, 5), (194, 294), (2000, 2)).T
    points = field.cell_to_world(rows, columns)
    exact = np.maximum(np.linalg.norm(points - goal, axis=1) - RADIUS, 0.0) / LIMITS.speed
    times, gradients = value.value_and_gradient(points)
    far = exact > 3.0
    assert np.median(np.abs(times - exact)[far] / exact[far]) < 0.003
    assert np.abs(times - exact).max() < 0.3
    points, gradients, exact = points[far], gradients[far], exact[far]
    toward = (np.asarray(goal) - points) / np.linalg.norm(goal - points, axis=1)[:, None]
    cosines = -(gradients * toward).sum(axis=1) / np.linalg.norm(gradients, axis=1)
    assert np.median(cosines) > 0.999
    assert np.linalg.norm(gradients, axis=1) == pytest.approx(1.0 / LIMITS.speed, rel=0.1)


def test_round_a_wall_the_time_is_that_of_the_shortest_way(two_rooms: OccupancyMap) -> None:
    solver = MapSolver(two_rooms, LIMITS, slowest=1.0)
    goal, start = two_rooms.cell_to_world(20, 30), two_rooms.cell_to_world(20, 92)
    value = solver.solve(tuple(goal), RADIUS)
    # A taut string from start to goal past the wall's end, round a disc that the robot's middle may not enter.
    room = LIMITS.room
    along = [math.hypot(1.5, 2.0), math.hypot(1.6, 2.0)]
    length = sum(math.sqrt(way**2 - room**2) for way in along) + 0.05 + room * 1.35
    assert float(value.value(start)) == pytest.approx((length - RADIUS) / LIMITS.speed, rel=0.03)
    path = value.path(start)
    assert path[0] == pytest.approx(start)
    assert math.dist(path[-1], goal) <= RADIUS + 0.05
    assert path_length(path) == pytest.approx(length - RADIUS, rel=0.06)
    away = solver.clearance[two_rooms.world_to_cell(path)]
    assert away.min() > room - 0.051


def test_near_walls_the_way_is_dear_and_too_near_it_leads_out(two_rooms: OccupancyMap) -> None:
    goal, start = tuple(two_rooms.cell_to_world(20, 30)), two_rooms.cell_to_world(20, 92)
    dear = MapSolver(two_rooms, LIMITS).solve(goal, RADIUS)
    short = MapSolver(two_rooms, LIMITS, slowest=1.0).solve(goal, RADIUS)
    assert short.value(start) < dear.value(start) < 1.3 * short.value(start)
    beside = two_rooms.cell_to_world(20, np.array([62, 63, 64, 65]))  # 2 to 17 cm from the wall between the rooms
    times, gradients = dear.value_and_gradient(beside)
    assert np.isfinite(times).all()
    assert (np.diff(times) < 0.0).all()
    outward = np.array((math.cos(0.3), math.sin(0.3)))
    assert (gradients[:2] @ outward < 0.0).all()


def test_what_no_way_leads_to_is_infinite_and_off_the_map_is_nan(two_rooms: OccupancyMap) -> None:
    value = MapSolver(two_rooms, LIMITS).solve(tuple(two_rooms.cell_to_world(20, 30)), RADIUS)
    assert np.isposinf(value.value(two_rooms.cell_to_world(8, 112)))  # in the closet
    assert len(value.path(two_rooms.cell_to_world(8, 112))) == 1
    assert np.isnan(value.value([[-50.0, 0.0], [np.nan, 0.0]])).all()


def test_obstacles_that_the_map_has_not_lengthen_or_close_the_way(two_rooms: OccupancyMap) -> None:
    solver = MapSolver(two_rooms, LIMITS)
    goal, start = tuple(two_rooms.cell_to_world(20, 30)), two_rooms.cell_to_world(20, 92)
    free = float(solver.solve(goal, RADIUS).value(start))
    post = two_rooms.cell_to_world(np.array([66]), np.array([61]))
    assert free < float(solver.solve(goal, RADIUS, post).value(start)) < free + 5.0
    row = two_rooms.cell_to_world(np.arange(60, 80, 2), np.full(10, 61))
    assert np.isposinf(solver.solve(goal, RADIUS, row).value(start))
    with pytest.raises(NavigationError, match="m from an obstacle"):
        solver.solve(goal, RADIUS, np.array([goal]))


def test_impossible_goals_are_refused_and_unwanted_work_ends(two_rooms: OccupancyMap) -> None:
    solver = MapSolver(two_rooms, LIMITS)
    with pytest.raises(NavigationError, match="lies off the map"):
        solver.solve((100.0, 0.0), RADIUS)
    with pytest.raises(NavigationError, match=r"is 0\.00 m from an obstacle or unknown space: the robot needs 0\.15 m"):
        solver.solve(tuple(two_rooms.cell_to_world(20, 61)), RADIUS)
    done: list[float] = []
    with pytest.raises(CancelledError):
        solver.solve(tuple(two_rooms.cell_to_world(20, 30)), RADIUS, None, done.append, lambda: False)
    solver.solve(tuple(two_rooms.cell_to_world(20, 30)), RADIUS, None, done.append)
    assert done[-1] > 0.8
    with pytest.raises(NavigationError, match="radius"):
        replace(LIMITS, radius=math.nan)


@pytest.mark.parametrize("name", MAPS)
def test_the_maps_that_ship_are_those_that_their_functions_make(name: str) -> None:
    shipped, made = load_map(name), make_map(name)
    assert name in map_names()
    assert np.array_equal(shipped.cells, made.cells)
    assert shipped.resolution == made.resolution
    with pytest.raises(NavigationError, match="no map 'nowhere': there are corridor, maze"):
        load_map("nowhere")

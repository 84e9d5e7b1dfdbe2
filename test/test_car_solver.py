"""The solver of a car's value: the same result on any number of cores, from its early end, and with obstacles added."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cars.maps import make_maze
from ctrl_rl_navigation.cars import CarLimits, CarSolver, CarValue
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap

CAR = CarLimits(1.0, 1.0, 2.0, 2.0, 0.6, 0.3, 3.0, 0.5, 0.3, 0.1)
GOAL = ((3.3, 0.8), 0.5, 0.1, 0.1)
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def solver() -> CarSolver:
    return CarSolver(make_maze(np.random.default_rng(3), 3, 3), CAR)


@pytest.fixture(scope="module")
def value(solver: CarSolver) -> CarValue:
    return solver.solve(*GOAL)


def poses(solver: CarSolver, count: int = 400) -> Array:
    """Draw poses (n, 3) at which the car fits."""
    height, width = solver.map.cells.shape
    size = np.array((width, height)) * solver.map.resolution
    drawn = np.random.default_rng(5).uniform((0.0, 0.0, -math.pi), (*size, math.pi), (count, 3))
    return np.asarray(drawn[solver.fits(drawn)])


def test_threads_do_not_change_the_result(solver: CarSolver, value: CarValue, monkeypatch: pytest.MonkeyPatch) -> None:
    for cores in (1, 3):
        monkeypatch.setattr("os.sched_getaffinity", lambda _, cores=cores: set(range(cores)))
        np.testing.assert_array_equal(CarSolver(solver.map, CAR).solve(*GOAL).all_times, value.all_times)


def test_an_early_end_keeps_the_times_near_the_car(solver: CarSolver, value: CarValue) -> None:
    start = poses(solver)[0]
    part = solver.solve(*GOAL, start=start)
    assert float(part.value(start)) == pytest.approx(float(value.value(start)), abs=0.01)
    known = np.isfinite(part.all_times)
    np.testing.assert_allclose(part.all_times[known], value.all_times[known], atol=0.02)


def test_obstacles_added_are_those_of_a_map_with_them(solver: CarSolver, value: CarValue) -> None:
    points = np.array(((1.8, 1.9), (1.85, 1.9), (0.7, 3.1)))
    cells = solver.map.cells.copy()
    cells[solver.map.world_to_cell(points)] = 100
    anew = CarSolver(OccupancyMap(cells, solver.map.resolution, solver.map.origin), CAR).solve(*GOAL)
    np.testing.assert_array_equal(solver.solve(*GOAL, points).all_times, anew.all_times)
    assert np.isfinite(value.all_times).sum() > np.isfinite(anew.all_times).sum()


def test_the_room_is_the_distance_to_the_nearest_occupied_cell(solver: CarSolver, value: CarValue) -> None:
    errors = []
    walls = solver.map.cell_to_world(*np.argwhere(solver.map.cells == 100).T)
    half, step = (0.5 * CAR.length, 0.5 * CAR.width), math.tau / len(value.room)
    for heading, row, column in np.argwhere((value.room > 0.03) & (value.room < 0.25))[::2003]:
        away, theta = walls - solver.grid.cell_to_world(row, column), heading * step
        c, s = math.cos(theta), math.sin(theta)
        beside = np.abs(away @ np.array(((c, -s), (s, c))) - (CAR.centre, 0.0)) - half
        exact = float(np.hypot(*np.maximum(beside, 0.0).T).min()) - 0.5 * solver.map.resolution
        errors.append(value.room[heading, row, column] - exact)
    assert len(errors) > 50
    assert abs(np.median(errors)) < 0.005
    assert np.abs(errors).max() < 0.02


def test_paths_keep_off_walls_and_last_as_long_as_the_value_says(solver: CarSolver, value: CarValue) -> None:
    starts = poses(solver)
    starts = starts[np.isfinite(value.value(starts))][:20]
    ways = [value.poses(start) for start in starts]
    assert all(solver.fits(way, 0.0).all() for way in ways)
    # Steps of a cell between states may end in a circle where two ways are equally long.
    there = [number for number, way in enumerate(ways) if math.dist(way[-1, :2], GOAL[0]) < 0.2]
    assert len(there) >= 18
    for number in there:
        assert 0.05 * len(ways[number]) < 1.25 * float(value.value(starts[number])) + 0.5


def test_a_solve_says_how_far_it_is(solver: CarSolver) -> None:
    told: list[float] = []
    solver.solve(*GOAL, report=told.append)
    assert told == sorted(told)
    assert 0.0 < told[0] < told[-1] <= 1.0

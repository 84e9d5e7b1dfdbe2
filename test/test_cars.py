"""A car's time to reach agrees with the closed form in the open, and cars drive to goals with a heading by it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from cars.command import main
from cars.drives import Drives, Trial, draw_trials
from cars.hybrid_a_star import HybridAStar
from cars.maps import Place, make_car_park, make_maze
from cars.reeds_shepp import shortest
from ctrl_rl_navigation.cars import CarLimits, CarSolver, car_limits_of

from ctrl_rl_core import OccupancyMap, find_robot, read_results
from ctrl_rl_navigation import NavigationError

SMALL = CarLimits(1.0, 1.0, 2.0, 2.0, 1.0, 0.5, 3.0, 0.6, 0.3, 0.1)


@pytest.mark.parametrize(
    ("pose", "length"),
    [
        ((3.0, 0.0, 0.0), 3.0),
        ((-2.0, 0.0, 0.0), 2.0),
        ((0.0, 2.0, math.pi), math.pi),
        ((1.0, 1.0, 0.5 * math.pi), 0.5 * math.pi),
        ((0.0, 0.0, math.pi), math.pi),  # three arcs of a sixth of a turn each
        ((math.sin(0.4), 1.0 - math.cos(0.4), 0.4), 0.4),
    ],
)
def test_the_closed_form_knows_simple_paths(pose: tuple[float, float, float], length: float) -> None:
    assert shortest(*pose) == pytest.approx(length, abs=1e-6)


def test_the_closed_form_is_symmetric() -> None:
    random = np.random.default_rng(1)
    for x, y, phi in random.uniform((-4, -4, -3), (4, 4, 3), (200, 3)):
        length = shortest(x, y, phi)
        assert shortest(x, -y, -phi) == pytest.approx(length)
        assert shortest(-x, y, -phi) == pytest.approx(length)
        c, s = math.cos(phi), math.sin(phi)
        assert shortest(-c * x - s * y, s * x - c * y, -phi) == pytest.approx(length)  # from the end to the start
        assert length >= math.hypot(x, y)


def length_to(pose: np.ndarray, goals: np.ndarray) -> float:
    """Return the closed form's length from a pose (3,) to the nearest of many (n, 3), for a turning radius of 1."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    away = goals - pose
    return min(shortest(c * dx + s * dy, c * dy - s * dx, turned) for dx, dy, turned in away)


def test_the_time_to_reach_is_that_of_the_closed_form_in_the_open() -> None:
    limits = CarLimits(1.0, 1.0, 1e6, 1e6, 1.0, 0.5, 1e6, 0.6, 0.3, 0.1)
    map_ = OccupancyMap(np.zeros((100, 100), np.int8), 0.08)
    value = CarSolver(map_, limits, cell=0.08).solve((4.0, 4.0), 0.5, 0.15, 0.15)
    there = np.argwhere(value.all_times[0] == 0.0)
    goals = np.column_stack((map_.cell_to_world(there[:, 1], there[:, 2]), there[:, 0] * math.tau / 72))
    random, errors = np.random.default_rng(2), []
    for pose in random.uniform((1.5, 1.5, -math.pi), (6.5, 6.5, math.pi), (80, 3)):
        exact = length_to(pose, goals)
        if exact > 0.5:
            errors.append(float(value.value(pose)) / exact - 1.0)
    assert abs(np.median(errors)) <= 0.02
    assert np.quantile(np.abs(errors), 0.9) <= 0.05


def test_walls_are_not_driven_through_and_a_pocket_has_no_way() -> None:
    cells = np.zeros((80, 120), np.int8)
    cells[:, 60:62] = 100
    value = CarSolver(OccupancyMap(cells, 0.05), SMALL).solve((1.0, 2.0), None, 0.1, 0.1)
    assert math.isfinite(float(value.value((2.0, 2.0, 1.0))))
    assert float(value.value((4.5, 2.0, 1.0))) == math.inf
    assert math.isnan(float(value.value((-1.0, 2.0, 0.0))))


@pytest.mark.parametrize(
    ("goal", "heading", "why"),
    [((9.0, 2.0), None, "lies off the map"), ((0.1, 2.0), 0.0, "does not fit at the goal")],
)
def test_a_goal_without_room_is_refused(goal: tuple[float, float], heading: float | None, why: str) -> None:
    solver = CarSolver(OccupancyMap(np.zeros((80, 120), np.int8), 0.05), SMALL)
    with pytest.raises(NavigationError, match=why):
        solver.solve(goal, heading, 0.1, 0.1)


def test_an_obstacle_that_is_not_on_the_map_lengthens_the_way() -> None:
    solver = CarSolver(OccupancyMap(np.zeros((80, 120), np.int8), 0.05), SMALL)
    start = (0.6, 2.0, 0.0)
    free = solver.solve((5.2, 2.0), 0.0, 0.1, 0.1).value(start)
    wall = np.column_stack((np.full(40, 3.0), np.linspace(1.0, 3.0, 40)))
    assert solver.solve((5.2, 2.0), 0.0, 0.1, 0.1, wall).value(start) > float(free) + 0.2


def test_the_path_is_as_long_as_the_value_says_and_touches_nothing() -> None:
    place = Place("maze", "race_car", make_maze(np.random.default_rng(3), 3, 3))
    limits = car_limits_of(find_robot(place.robot))
    solver = CarSolver(place.map, limits)
    (trial,) = draw_trials(place, solver, 1, 5)
    value = solver.solve((float(trial.goal[0]), float(trial.goal[1])), float(trial.goal[2]), 0.09, 0.1)
    poses = value.poses(trial.start)
    assert math.dist(poses[-1, :2], trial.goal[:2]) < 0.25
    assert solver.fits(poses, 0.0).all()


@pytest.mark.parametrize("engine", ["planar", "pybullet", "mujoco"])
def test_a_car_drives_through_a_maze(engine: str) -> None:
    if engine != "planar":
        pytest.importorskip(engine)
    place = Place("maze", "race_car", make_maze(np.random.default_rng(3), 3, 3))
    drives = Drives(place, engine)
    try:
        for number, trial in enumerate(draw_trials(place, drives.solver, 1, 6)):
            ride = drives.ride(trial, number)
            assert ride.arrived
            assert ride.seconds < 2.0 * ride.optimal
    finally:
        drives.close()


@pytest.mark.parametrize("filtered", [False, True])
def test_a_car_passes_a_pole_and_parks_in_the_narrow_bay_behind_it(filtered: bool) -> None:
    cells = np.zeros((100, 160), np.int8)
    cells[:, 136:] = 100
    cells[43:57, 136:156] = 0  # a bay of 0.7 m; the car with its margins is 0.41 m wide
    cells[50, 106] = 100
    cells[[0, -1]], cells[:, [0, -1]] = 100, 100
    drives = Drives(Place("bay", "race_car", OccupancyMap(cells, 0.05)), "planar", filtered)
    try:
        ride = drives.ride(Trial(np.array((1.0, 2.5, 0.0)), np.array((7.1, 2.5, 0.0))), 0)
        assert ride.arrived
        assert ride.seconds < 2.0 * ride.optimal
    finally:
        drives.close()


def test_a_full_size_car_parks_in_a_narrow_bay() -> None:
    map_, bays = make_car_park(np.random.default_rng(4), 6, 1)
    place = Place("parking", "road_car", map_, bays)
    drives = Drives(place, "planar")
    try:
        trials = [trial for trial in draw_trials(place, drives.solver, 20, 7) if abs(math.cos(trial.goal[2])) < 1e-6]
        assert drives.ride(trials[0], 0).arrived
    finally:
        drives.close()


def test_a_hybrid_a_star_needs_about_as_long() -> None:
    place = Place("maze", "race_car", make_maze(np.random.default_rng(3), 3, 3))
    limits = car_limits_of(find_robot(place.robot))
    solver = CarSolver(place.map, limits)
    for trial in draw_trials(place, solver, 3, 5):
        goal, heading = (float(trial.goal[0]), float(trial.goal[1])), float(trial.goal[2])
        best = float(solver.solve(goal, heading, 0.09, 0.1).value(trial.start))
        plan = HybridAStar(place.map, limits, 0.05).plan(trial.start, goal, heading, (0.09, 0.1))
        assert 0.85 * best < plan.seconds < 1.5 * best + 1.0


def test_it_writes_a_method_a_map_and_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    output = tmp_path / "cars.json"
    monkeypatch.setattr("cars.maps.make_maze", lambda random: make_maze(random, 3, 3))
    words = ["cars", "--maps", "maze", "--goals", "1", "--plans", "1", "--output", str(output)]
    monkeypatch.setattr("sys.argv", words)
    assert main() == 0
    (experiment,) = read_results(tmp_path)
    metrics = {(row.method, row.metric) for row in experiment.rows}
    assert ("maze, race_car, planar", "arrived") in metrics
    assert ("maze, race_car, hybrid A*, plan alone", "solve seconds") in metrics


@pytest.mark.parametrize("words", [["--maps", "moon"], ["--engines", "steam"], ["--goals", "0"]])
def test_what_cannot_be_driven_is_one_line(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["cars", *words])
    assert main() == 2
    assert capsys.readouterr().err.startswith("cars: ")

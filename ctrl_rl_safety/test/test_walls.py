"""Classification of echoes as walls: static and larger than any mover, excluding people who lean on a wall."""

import numpy as np
import pytest
from ctrl_rl_safety.filter.walls import Walls, surfaces_of

SIZE = 1.0
RANDOM = np.random.default_rng(0)


def walls(points: np.ndarray, known: np.ndarray, size: float) -> np.ndarray:
    """Return which echoes of a first scan belong to walls."""
    return Walls(size).update(0.0, points, known)


def line(begin: tuple[float, float], end: tuple[float, float], spacing: float = 0.03) -> np.ndarray:
    """Return points from start to end, as measured by a lidar with 1 cm of noise."""
    count = round(float(np.hypot(*np.subtract(end, begin))) / spacing)
    return np.linspace(begin, end, count) + RANDOM.normal(0.0, 0.01, (count, 2))


def person(x: float, y: float, radius: float = 0.2) -> np.ndarray:
    """Return the side of a disc that faces the robot at the origin below it."""
    angles = np.linspace(np.pi, 2.0 * np.pi, 20)
    return np.column_stack((x + radius * np.cos(angles), y + radius * np.sin(angles)))


def test_a_long_surface_that_has_stood_is_a_wall_and_a_short_one_is_none() -> None:
    long, short = line((-1.0, 1.0), (1.0, 1.0)), line((-0.4, -1.0), (0.4, -1.0))
    points = np.concatenate((long, short))
    known = np.ones(len(points), bool)
    found = walls(points, known, SIZE)
    assert found[: len(long)].all()
    assert not found[len(long) :].any()
    known[: len(long)] = False
    assert not walls(points, known, SIZE).any()


@pytest.mark.parametrize("away", [0.25, 0.5, 1.0])
def test_noise_does_not_break_a_wall_however_near_it_is(away: float) -> None:
    bearings = np.radians(np.arange(-60.0, 61.0))
    for _ in range(20):
        ranges = away / np.cos(bearings) + RANDOM.normal(0.0, 0.01, len(bearings))
        seen = np.column_stack((ranges * np.sin(bearings), ranges * np.cos(bearings)))
        (part,) = surfaces_of(seen, np.ones(len(seen), bool))
        assert len(part) == len(seen)


@pytest.mark.parametrize("gap", [0.0, 0.05, 0.3])
def test_who_stands_before_a_wall_or_leans_on_it_is_no_wall(gap: float) -> None:
    somebody = person(0.0, 1.0 - 0.2 - gap)
    points = np.concatenate((line((-2.0, 1.0), (-0.22, 1.0)), somebody, line((0.22, 1.0), (2.0, 1.0))))
    first = len(line((-2.0, 1.0), (-0.22, 1.0)))
    found = walls(points, np.ones(len(points), bool), SIZE)
    assert not found[first + 2 : first + len(somebody) - 2].any()
    assert found[: first - 8].all()
    assert found[first + len(somebody) + 8 :].all()


def test_two_who_stand_side_by_side_are_no_wall() -> None:
    points = np.concatenate((person(-0.42, 1.0), person(0.0, 1.0), person(0.42, 1.0)))
    assert not walls(points, np.ones(len(points), bool), SIZE).any()


def test_a_closed_round_room_is_a_wall_and_few_echoes_are_none() -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    room = 1.5 * np.column_stack((np.cos(angles), np.sin(angles)))
    assert walls(room, np.ones(len(room), bool), SIZE).all()
    for count in (0, 1, 2, 3):
        assert not walls(room[:count], np.ones(count, bool), SIZE).any()


def test_a_wall_of_which_a_part_is_hidden_later_is_remembered_for_a_while_and_who_walks_off_it_is_not() -> None:
    seen, wall = Walls(SIZE), line((-1.0, 1.0), (1.0, 1.0))
    assert seen.update(0.0, wall, np.ones(len(wall), bool)).all()
    part, aside = line((-0.3, 1.0), (0.4, 1.0)), line((-0.3, 1.3), (0.4, 1.3))
    assert seen.update(1.0, part, np.ones(len(part), bool)).all()
    assert not seen.update(1.2, part, np.zeros(len(part), bool)).any()
    assert not seen.update(1.4, aside, np.ones(len(aside), bool)).any()
    assert not seen.update(8.0, part, np.ones(len(part), bool)).any()
    seen.update(9.0, wall, np.ones(len(wall), bool))
    for step in range(1, 10):  # flat, 0.4 m wide, and slow enough to be taken for standing
        flat = line((-0.2, 1.0 - 0.03 * step), (0.2, 1.0 - 0.03 * step))
        found = seen.update(9.0 + 0.2 * step, flat, np.ones(len(flat), bool))
        assert step < 4 or not found.any()


def test_a_wall_goes_on_where_it_bends_slowly() -> None:
    seen, angles = Walls(SIZE), np.linspace(0.0, 3.0, 100)
    inside = 0.6 * np.column_stack((np.cos(angles), np.sin(angles)))
    start = np.concatenate((line((0.6, -1.0), (0.6, -0.03)), inside[:40]))
    assert seen.update(0.0, start, np.ones(len(start), bool)).all()
    for first in range(5, 60, 5):
        arc = inside[first : first + 35]
        assert seen.update(0.2 * first / 5, arc, np.ones(len(arc), bool)).all()

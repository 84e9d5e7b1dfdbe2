"""People are tracked, also while something hides them, and the robot waits for them, makes room and leaves."""

import math

import numpy as np
import pytest
from ctrl_rl_navigation.driving.look_ahead import Choice, LookAhead
from ctrl_rl_navigation.people import Tracker
from ctrl_rl_navigation.people.movers import NOBODY, advanced, mover, placed
from ctrl_rl_navigation.people.space_time import SpaceTime
from ctrl_rl_navigation.robot import limits_of
from ctrl_rl_navigation.values.map_solver import MapSolver
from test_explorer import look

from ctrl_rl_core import OccupancyMap, find_robot

BURGER = limits_of(find_robot("turtlebot3_burger"))
NONE = np.empty((0, 2))
VALUE = MapSolver(OccupancyMap(np.zeros((120, 200), np.int8), 0.05, (-4.0, -3.0, 0.0)), BURGER).solve((4.0, 0.0), 0.1)


def walker(x: float, y: float, vx: float, vy: float) -> np.ndarray:
    """Return somebody whose place and velocity are known well."""
    return mover(np.array((x, y)), np.array((vx, vy)), 0.25, (1e-3, 0.0, 1e-3))[None]


def choose(movers: np.ndarray, command: tuple[float, float] = (0.0, 0.0), theta: float = 0.0) -> Choice:
    ahead = LookAhead(BURGER, 0.1, 0.2, 0.5)
    return ahead.choose(VALUE, np.array((0.0, 0.0, theta)), np.array(command), NONE, movers=movers)


def test_only_what_moves_is_a_mover_and_has_its_velocity() -> None:
    tracker = Tracker()
    for step in range(12):
        now = 0.1 * step
        origin, ends, echoes = look((3.0, 1.0 - now), (2.0, 2.0), (-2.0, 0.0), origin=(0.3 * now, 0.1 * now))
        moves = tracker.update(now, origin, ends, echoes)
    goes = (ends[echoes][:, 0] > 2.5) & (ends[echoes][:, 1] < 1.0)
    np.testing.assert_array_equal(moves, goes)
    (row,) = tracker.movers()
    np.testing.assert_allclose(row[:5], (3.0, 1.0 - now, 0.0, -1.0, 0.2), atol=0.1)


def test_somebody_who_goes_away_or_comes_straight_on_moves_too() -> None:
    for speed in (-0.5, 0.5):
        tracker = Tracker()
        for step in range(12):
            tracker.update(0.1 * step, *look((2.0 + 0.1 * step * speed, 0.0)))
        (row,) = tracker.movers()
        np.testing.assert_allclose(row[2:4], (speed, 0.0), atol=0.12)


@pytest.mark.parametrize("scale", [0.95, 1.05])
def test_posts_stand_where_the_odometry_says_too_little_or_too_much_of_a_turn(scale: float) -> None:
    tracker = Tracker()
    posts = np.array([(x, y) for x in (1.5, 3.0) for y in (-1.5, 0.0, 1.5)])
    for step in range(60):
        wrong = (scale - 1.0) * 0.2 * step  # of a robot that turns at 2 rad/s
        c, s = math.cos(wrong), math.sin(wrong)
        origin, ends, echoes = look(*(posts @ np.array(((c, s), (-s, c)))).tolist(), radius=0.15)
        moves = tracker.update(0.1 * step, origin, ends, echoes, 0.2 * step * scale)
        assert not moves.any(), step


def test_posts_stand_however_the_robot_drives_past_them() -> None:
    tracker, random = Tracker(), np.random.default_rng(0)
    posts = [(x, y) for x in (1.0, 2.0, 3.0) for y in (-1.0, 0.8)]
    for step in range(60):
        origin, ends, echoes = look(*posts, origin=(0.06 * step, 0.2 * math.sin(0.2 * step)), radius=0.15)
        echoes &= random.random(len(echoes)) > 0.1  # beams are lost
        ends = ends + random.normal(0.0, 0.01, ends.shape)
        assert not tracker.update(0.1 * step, origin, ends, echoes).any()
    assert len(tracker.movers()) == 0


def test_somebody_behind_a_post_goes_on_and_is_forgotten_where_nobody_is() -> None:
    tracker = Tracker()
    for step in range(25):
        now = 0.1 * step
        tracker.update(now, *look((3.0, 1.2 - 0.5 * now), (1.0, 0.0)))  # hidden from 0.6 m on
    (row,) = tracker.movers()
    assert row[1] == pytest.approx(1.2 - 0.5 * now, abs=0.15)
    assert row[5] > 0.01
    for _ in range(4):
        now += 0.1
        tracker.update(now, *look())
    assert len(tracker.movers()) == 0


def test_somebody_who_stopped_may_go_on_and_is_an_obstacle_after_a_while() -> None:
    tracker = Tracker()
    for step in range(100):
        now = 0.1 * step
        moves = tracker.update(now, *look((2.0, 1.0 - 0.5 * min(now, 1.5))))
        if step == 30:
            stays, goes, returns = tracker.movers()
            assert stays[8] + goes[8] + returns[8] == pytest.approx(1.0)
            assert math.hypot(*stays[2:4]) < 0.1
            assert goes[3] == -returns[3]
            assert goes[3] == pytest.approx(-0.5, abs=0.25)
    assert len(tracker.movers()) == 0
    assert not moves.any()


def test_somebody_who_has_turned_round_before_is_expected_to_turn_round_there_again() -> None:
    tracker, random = Tracker(), np.random.default_rng(0)

    def place(time: float) -> tuple[float, float]:  # 4 s of a way, 2 s at either end
        phase = time % 12.0
        return 2.0, 0.5 * (min(phase, 4.0) - min(max(phase - 6.0, 0.0), 4.0)) - 1.0

    for step in range(270):
        now = 0.1 * step
        origin, ends, echoes = look(place(now))
        tracker.update(now, origin, ends + random.normal(0.0, 0.01, ends.shape), echoes)
        if step in (29, 269):  # on the way there, one second before it turns round
            movers = tracker.movers()
            for ahead in (1.0, 2.0, 4.5):
                held = movers[(movers[:, 9] <= ahead) & (ahead < movers[:, 10])]
                assert held[:, 8].sum() == pytest.approx(1.0)
                away = np.hypot(*(held[:, :2] + ahead * held[:, 2:4] - place(now + ahead)).T)
                assert (held[away < 0.3, 8].sum() > 0.35) == (step > 100 or ahead < 1.5)


def test_movers_change_frames_and_advance() -> None:
    moved = placed(advanced(walker(1.0, 0.0, 0.0, 1.0), 2.0), 1.0, 0.0, 0.5 * math.pi)
    np.testing.assert_allclose(moved[0, :4], (2.0, 0.0, 1.0, 0.0), atol=1e-9)
    assert moved[0, 5] == pytest.approx(1e-3 + 4e-3)


def test_nobody_causes_no_delay_and_somebody_far_away_hardly_any() -> None:
    assert choose(NOBODY).cost == pytest.approx(choose(walker(0.0, 20.0, 0.0, 0.0)).cost, abs=0.2)
    window = SpaceTime(BURGER, 1.6).window(VALUE, np.zeros(3), walker(0.0, 20.0, 0.0, 0.0), NONE)
    assert 0.0 <= window.delays.min() <= window.delays.max() < 0.2


def test_it_waits_for_somebody_who_crosses_and_drives_on_behind_somebody_who_has_crossed() -> None:
    crossing = choose(walker(0.45, 0.9, 0.0, -0.5), (0.22, 0.0))
    assert crossing.command[0] < 0.22
    assert choose(walker(0.45, -0.5, 0.0, -0.5), (0.22, 0.0)).command[0] == pytest.approx(0.22)


def test_a_robot_that_stands_leaves_when_somebody_comes() -> None:
    ahead = LookAhead(BURGER, 0.1, 0.2, 0.5)
    pose, command, least = np.zeros(3), np.zeros(2), math.inf
    for step in range(60):
        now = 0.1 * step
        person = walker(2.0 - 0.5 * now, 0.0, -0.5, 0.0)
        command = ahead.choose(VALUE, pose, command, NONE, movers=person).command
        pose = pose + 0.1 * np.array((command[0] * math.cos(pose[2]), command[0] * math.sin(pose[2]), command[1]))
        least = min(least, math.dist(pose[:2], person[0, :2]))
    assert least > 0.25 + BURGER.radius

"""An echo stays until beams have passed through its place often enough, and one empty scan frees nothing."""

import math
from dataclasses import replace

import numpy as np
import pytest
from ctrl_rl_safety.filter.evidence import (
    FIXED,
    Beams,
    EchoEvidence,
    beams_at,
    beams_from,
    beams_of,
    kinds_of,
    passes_needed,
    widths,
)
from ctrl_rl_safety.models.motion import motion_of
from light_world import roll_out

from ctrl_rl_core import ScanGeometry, find_robot
from ctrl_rl_safety import FilterOptions, Reading, RobotModel, SafetyFilter, find_model

MODEL = find_model("turtlebot3_burger")
BEARINGS = np.radians(np.arange(-180.0, 180.0, 1.0))
ORIGIN = np.zeros(3)
NOTHING = np.full(360, np.inf)
K = passes_needed(0.1)
STEP = 0.02


def scan(*readings: tuple[float, float]) -> Beams:
    """Return beams that see nothing except at bearings [deg] a range [m]."""
    ranges = NOTHING.copy()
    for bearing, distance in readings:
        ranges[round(bearing) + 180] = distance
    return beams_at(BEARINGS, ranges)


def seen(model: RobotModel = MODEL, x: float = 0.8, y: float = 0.0) -> EchoEvidence:
    """Return a memory with one echo."""
    evidence = EchoEvidence(model, 5.0)
    evidence.look(0.0, ORIGIN, scan((0.0, x)))
    evidence.note(0.0, np.array([[x, y]]), np.array([FIXED], np.int8))
    return evidence


def held(evidence: EchoEvidence, beams: Beams, scans: int, pose: np.ndarray = ORIGIN) -> int:
    """Return how many echoes are left after some scans that show the same."""
    for k in range(scans):
        out = evidence.look(0.1 * (k + 1), pose, beams)
        evidence.note(0.1 * (k + 1), np.empty((0, 2)), np.empty(0, np.int8))
    return len(out.places)


@pytest.mark.parametrize(("rate", "count"), [(0.0, 0), (0.01, 3), (0.1, 5), (0.2, 8), (0.3, 10), (0.5, 17)])
def test_a_rate_of_missing_says_how_many_passes_are_needed(rate: float, count: int) -> None:
    assert passes_needed(rate) == count
    assert rate == 0.0 or rate**count <= 1.001e-5 < rate ** (count - 1)


def test_an_echo_is_forgotten_after_as_many_passes_in_a_row_and_not_before() -> None:
    assert held(seen(), scan(), K - 1) == 1
    assert held(seen(), scan(), K) == 0
    assert held(seen(replace(MODEL, missing_rate=0.3)), scan(), 9) == 1
    assert held(seen(replace(MODEL, missing_rate=0.0)), scan(), 1) == 0
    evidence = seen()
    assert held(evidence, scan(), K - 1) == 1
    evidence.look(1.0, ORIGIN, scan((0.0, 0.81)))  # seen again: passes begin anew
    evidence.note(1.0, np.array([[0.81, 0.0]]), np.array([FIXED], np.int8))
    assert held(evidence, scan(), K - 1) == 1


def test_beams_with_an_echo_beyond_count_as_those_without() -> None:
    assert held(seen(), scan(*((b, 3.0) for b in (-1, 0, 1))), K) == 0


@pytest.mark.parametrize(
    ("what", "beams"),
    [
        ("something nearer hides it", scan(*((b, 0.4) for b in range(-3, 4)))),
        ("one beam beside it is blocked", scan((0.0, 0.4))),
        ("no beam looks there", Beams(*scan()[:2], 0.9, 0.0)),
        ("the field ends before it", beams_at(BEARINGS[190:], NOTHING[190:])),
    ],
)
def test_what_is_not_looked_at_is_no_evidence(what: str, beams: Beams) -> None:
    assert held(seen(), beams, 20) == 1, what


def test_a_thin_pole_may_stand_between_two_beams_far_apart_and_a_surface_may_not() -> None:
    assert held(seen(x=2.0), scan(), 20) == 1  # 3.5 cm between beams
    evidence = EchoEvidence(MODEL, 5.0)
    wall = np.column_stack((np.full(5, 2.0), 0.04 * np.arange(-2, 3)))
    evidence.look(0.0, ORIGIN, scan())
    evidence.note(0.0, wall, np.full(5, FIXED, np.int8))
    assert held(evidence, scan(), K - 1) == 5
    assert held(evidence, scan(), 1) == 0


def test_a_surface_reaches_to_its_neighbours_and_two_posts_are_none() -> None:
    assert widths(np.array([(2.0, 0.0), (2.0, 0.05), (2.0, 0.1), (1.0, 1.0)])) == pytest.approx(
        [0.05, 0.05, 0.05, 0.02]
    )
    assert widths(np.array([(2.0, 0.0), (2.0, 0.05), (1.0, 1.0)])) == pytest.approx([0.02, 0.02, 0.02])


def test_odometry_that_may_have_drifted_and_the_robots_own_place_end_an_echo() -> None:
    hidden = scan(*((b, 0.4) for b in range(-9, 10)))
    evidence = seen()
    assert len(evidence.look(9.9, ORIGIN, hidden).places) == 1
    assert len(evidence.look(10.1, ORIGIN, hidden).places) == 0
    evidence = seen()
    for x in np.arange(0.0, 3.2, 0.1):
        left = len(evidence.look(1.0, np.array((-x, 0.0, 0.0)), hidden).places)
        assert left == (x < 3.05)
    assert held(seen(), hidden, 1, np.array((0.8, 0.0, 0.0))) == 0


def test_memory_is_bounded() -> None:
    evidence, blind = EchoEvidence(MODEL, 5.0), Beams(np.empty((0, 2)), np.empty(0, np.bool_), 0.0, 0.0)
    random = np.random.default_rng(0)
    for k in range(10):
        out = evidence.look(0.1 * k, ORIGIN, blind)
        places = random.uniform(1.0, 3.0, (500, 2))
        evidence.note(0.1 * k, places, kinds_of(np.ones(500, bool), np.ones(500, bool)))
    assert len(out.places) == 1000


def test_beams_of_a_scan_without_a_return_are_zero_infinite_or_nan() -> None:
    geometry = ScanGeometry(5, -0.2, 0.1, 0.1, 5.0)
    beams = beams_of(np.array((0.0, np.inf, np.nan, 9.0, 2.0), np.float32), geometry, 0.05)
    assert beams.returned.tolist() == [False, False, False, False, True]
    assert beams.ends[4] == pytest.approx((0.05 + 2.0 * math.cos(0.2), 2.0 * math.sin(0.2)))
    assert np.arctan2(beams.ends[:, 1], beams.ends[:, 0] - 0.05) == pytest.approx(np.arange(-0.2, 0.21, 0.1))


def test_without_beams_no_beam_passes_through_a_surface() -> None:
    wall = np.column_stack((np.full(41, 1.0), np.linspace(-1.0, 1.0, 41)))
    beams = beams_from(wall, 0.2)
    empty = beams.ends[~beams.returned]
    assert np.abs(np.arctan2(empty[:, 1], empty[:, 0])).min() > math.atan2(0.99, 1.0)
    assert beams_from(np.empty((0, 2)), 0.2).returned.sum() == 0


def test_where_movers_may_be_what_moved_away_leaves_a_place_that_stays_and_nothing_comes_from_it() -> None:
    safety = SafetyFilter(MODEL, FilterOptions(mover_speed=1.0))
    safety.see(0.0, ORIGIN, np.array([(1.0, 0.0)]), beams=scan((0.0, 1.0)))
    away = 1.05 * np.array([(math.cos(0.1), math.sin(0.1))])
    for k in range(1, K + 1):
        safety.see(0.1 * k, ORIGIN, away, beams=scan((6.0, 1.05)))
        assert safety.obstacles is not None
        assert safety.obstacles.fixed.shape[1] == (k < K)
        assert safety.obstacles.moving.shape[1] == 1
    safety.see(0.1 * (K + 1), ORIGIN, np.empty((0, 2)), beams=scan())  # it is missed: it may still come
    assert safety.obstacles is not None
    assert safety.obstacles.moving.shape[1] == 1


def test_after_a_jump_of_odometry_the_robot_waits_until_a_thing_cannot_have_been_missed() -> None:
    safety = SafetyFilter(MODEL)
    safety.see(0.0, ORIGIN, np.array([(1.0, 0.0)]))
    assert safety.obstacles is not None
    safety.forget()
    for k in range(1, K + 1):
        assert safety.obstacles is None
        safety.see(0.1 * k, ORIGIN, np.array([(1.0, 0.0)]) if k == 1 else np.empty((0, 2)))
    assert safety.obstacles is not None
    assert safety.obstacles.fixed.shape[1] == 1


def test_the_rate_is_the_robot_files_and_survives_saving(tmp_path) -> None:
    assert find_robot("jackal").lidar.missing_rate == find_model("jackal").missing_rate == 0.1
    replace(MODEL, missing_rate=0.25).save(tmp_path / "mine.yaml")
    assert find_model(str(tmp_path / "mine.yaml")).missing_rate == 0.25


CUSTOM = RobotModel("custom", 0.25, 1.0, 0.5, 1.5, 0.8, 0.6, 2.0, 0.1, 0.2, 0.03, 0.03)


@pytest.mark.parametrize("model", [CUSTOM, find_model("jackal"), find_model("turtlebot2")], ids=lambda each: each.name)
def test_one_empty_scan_lets_no_robot_touch_a_wall(model: RobotModel) -> None:
    stop = model.stopping_distance(model.speed) + model.speed * model.delay
    for missed_at in (1.1, 0.9, 0.7, 0.5):
        assert nearest(model, missed_at * stop) > 0.0
    assert nearest(replace(model, missing_rate=0.0), 0.7 * stop) < nearest(model, 0.7 * stop)


def nearest(model: RobotModel, missed_at: float) -> float:
    """Return the gap that a full-speed drive at a wall 4 m ahead leaves [m]; the first scan within a gap is empty."""
    safety, wall = SafetyFilter(model, FilterOptions()), np.arange(-9.0, 9.0, 0.04)
    motion, state, sent, missed, gap = motion_of(model, STEP), np.zeros(5), np.zeros(2), False, 4.0
    least = 4.0
    late = round(model.delay / STEP)
    commands = [np.zeros(2)] * late
    for i in range(500):
        c, s = math.cos(state[2]), math.sin(state[2])
        gap = 4.0 - state[0] - (model.core[0] * abs(c) + model.core[1] * abs(s) or model.radius)
        least = min(least, gap)
        if gap <= 0.0:
            break
        if i % 5 == 0:
            missing = not missed and gap < missed_at
            missed |= missing
            echoes = np.column_stack((4.0 - state[0] + 0.0 * wall, wall - state[1])) @ np.array(((c, -s), (s, c)))
            safety.see(i * STEP, state[:3].copy(), echoes[:0] if missing else echoes)
        if i % 2 == 0:
            reading = Reading(state[:3].copy(), float(state[3]), float(state[4]))
            sent = safety.decide(i * STEP, reading, np.array((model.speed, 0.0))).command
            safety.sent(i * STEP, sent)
        commands.append(sent)
        state = roll_out(state, commands[i][None], motion)[1]
    return least

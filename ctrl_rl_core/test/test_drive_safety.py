"""Unusable scans and obstacles, and the commands they permit."""

import math

import numpy as np
import pytest
from ctrl_rl_core.sensing.scan import DIRECTIONS, MOST_BEAMS, view_scan
from ctrl_rl_core.sensing.scan_health import MIXED
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ctrl_rl_core import DriveSafety, ObstacleStop, ScanError, ScanGeometry, ScanHealth

TURN = 2.0 * math.pi
LDS01 = ScanGeometry(360, 0.0, TURN / 360, 0.12, 3.5)
BEARINGS = np.arange(360) * TURN / 360
DRIVING = (0.2, 0.0)
AHEAD = np.array((0.2, 0.1))
ROBOT = ObstacleStop(radius=0.125, margin=0.02, deceleration=0.5, delay=0.3)


def corridor(seed: int = 0, front: float = 3.4) -> np.ndarray:
    """Return a noisy scan between walls 0.7 m apart, with a wall ahead at `front` [m]."""
    side = 0.35 / np.maximum(np.abs(np.sin(BEARINGS)), 1e-9)
    ahead = np.where(np.cos(BEARINGS) > 0, front / np.maximum(np.cos(BEARINGS), 1e-9), 3.4)
    noise = np.random.default_rng(seed).normal(0.0, 0.005, 360)
    return (np.minimum(np.minimum(side, ahead), 3.4) + noise).astype(np.float32)


def new(**changes: float) -> DriveSafety:
    health = {"min_echo_share": 0.3, "largest_gap": 2.1, "frozen_scans": 2} | changes
    return DriveSafety(ScanHealth(**health), ROBOT, 0.0, 1.0)  # type: ignore[arg-type]


def see(safety: DriveSafety, ranges: np.ndarray, step: int = 0, scan: ScanGeometry = LDS01, frame: str = "a") -> str:
    safety.update(0.2 * step, 200_000_000 * step, frame, ranges.astype(np.float32), scan, DRIVING)
    return safety.fault


def refused(safety: DriveSafety, command: np.ndarray = AHEAD) -> str:
    """Return why a command is rejected completely."""
    with pytest.raises(ScanError) as error:
        safety.limit(command, 0.2, 0.0)
    return str(error.value)


@pytest.mark.fault
@pytest.mark.parametrize("nothing", [0.0, np.inf, np.nan, 100.0, 0.05])
def test_a_scan_without_echoes_is_no_free_space(nothing: float) -> None:
    safety = new()
    assert "0 % of the scan's beams have an echo" in see(safety, np.full(360, nothing))
    assert "have an echo" in refused(safety)
    open_field = new(min_echo_share=0.0, largest_gap=6.3)
    assert see(open_field, np.full(360, nothing)) == ""
    assert open_field.limit(AHEAD, 0.2, 0.0)[1] == "", "who asks for it drives in the open"


@pytest.mark.fault
@pytest.mark.parametrize("first", [0, 90, 180, 270])
def test_a_covered_half_stops_what_drives_towards_it_and_nothing_else(first: int) -> None:
    """Left, right and front halves count as ahead; a covered rear half matters only when backing off."""
    ranges = np.roll(corridor(), -first)
    ranges[:180] = 0.0
    ranges[[10, 70, 130]] = 0.4  # specks of dust
    safety = new()
    assert see(safety, np.roll(ranges, first)) == ""
    behind = first == 90
    back = np.array((-0.1, 0.0))
    if behind:
        assert safety.limit(AHEAD, 0.2, 0.0)[0].tolist() == AHEAD.tolist()
        assert "behind" in refused(safety, back)
    else:
        assert "no echoes within 120 deg ahead" in refused(safety)
    assert safety.limit(np.array((0.0, 0.5)), 0.2, 0.0)[0].tolist() == [0.0, 0.5], "it may turn on the spot"


def test_single_lost_beams_and_the_open_end_of_a_corridor_are_no_fault() -> None:
    ranges = corridor()
    ranges[np.random.default_rng(0).random(360) < 0.3] = 0.0
    safety = new()
    assert see(safety, ranges) == ""
    assert safety.limit(AHEAD, 0.2, 0.0)[1] == ""
    half_angle = math.atan(0.4 / 0.3)
    ranges = corridor()
    ranges[np.abs((BEARINGS + math.pi) % TURN - math.pi) < half_angle] = 0.0
    assert see(safety, ranges, 1) == ""
    assert safety.limit(AHEAD, 0.2, 0.0)[1] == ""


@pytest.mark.fault
def test_a_frozen_lidar_stops_a_robot_that_moves_and_only_that() -> None:
    safety, ranges = new(), corridor().astype(np.float32)

    def frozen(step: int, motion: tuple[float, float], stamp: int) -> str:
        safety.update(0.2 * step, stamp, "a", ranges, LDS01, motion)
        return safety.fault

    assert [frozen(step, (0.0, 0.0), step) for step in range(5)] == [""] * 5, "one that stands sees the same"
    assert [frozen(step, (0.2, 0.0), 4) for step in range(5, 9)] == [""] * 4, "the same message again is no scan"
    assert frozen(9, (0.2, 0.0), 9) == ""
    assert "lidar frozen" in frozen(10, (0.0, 0.3), 10)
    assert "lidar frozen" in frozen(11, (0.0, 0.0), 11), "it goes on as long as the content does"
    assert see(safety, corridor(1), 12) == ""


@pytest.mark.fault
def test_two_lidars_on_one_topic_stop_the_robot_and_an_exchanged_one_only_for_a_moment() -> None:
    safety = new()
    assert see(safety, corridor(0), 0) == ""
    for step in range(1, 6):
        assert "two lidars on one topic: frames a and b" in see(safety, corridor(step), step, frame="ab"[step % 2])
    after = 5 + math.ceil(MIXED / 0.2)
    assert see(safety, corridor(6), after, frame="b") == ""
    other = ScanGeometry(360, 0.0, TURN / 360, 0.15, 12.0)
    assert "two lidars" in see(safety, corridor(7), after + 1, scan=other, frame="b")
    steps = range(after + 20, after + 24)
    counts = [ScanGeometry(beams, 0.0, TURN / beams, 0.15, 12.0) for beams in (268, 270, 274, 269)]
    unfit = [
        see(safety, corridor(step)[: scan.beams], step, scan=scan, frame="b")
        for step, scan in zip(steps, counts, strict=True)
    ]
    assert unfit == [""] * 4, "an LDS-02's count of beams varies"


@pytest.mark.fault
@pytest.mark.parametrize(
    "scan",
    [
        ScanGeometry(0, 0.0, 0.01, 0.1, 3.5),
        ScanGeometry(MOST_BEAMS + 1, 0.0, 1e-4, 0.1, 3.5),
        ScanGeometry(360, math.nan, 0.01, 0.1, 3.5),
        ScanGeometry(360, 0.0, math.inf, 0.1, 3.5),
        ScanGeometry(360, 0.0, 0.0, 0.1, 3.5),
        ScanGeometry(360, 1e30, 0.01, 0.1, 3.5),
        ScanGeometry(360, 0.0, 0.01, 3.5, 0.1),
        ScanGeometry(360, 0.0, 0.01, math.nan, 3.5),
    ],
)
def test_a_geometry_that_no_lidar_has_is_refused(scan: ScanGeometry) -> None:
    safety = new()
    assert "scan with" in see(safety, np.ones(scan.beams), scan=scan)
    assert "scan with" in refused(safety)


def test_points_lie_where_the_beams_met_something() -> None:
    seen = view_scan(corridor(), LDS01, reach=1.0, forward=-0.032)
    assert len(seen.points) > 100
    assert np.abs(np.abs(seen.points[:, 1]) - 0.35).max() < 0.03
    wall = view_scan(corridor(front=0.5), LDS01, reach=1.0, forward=-0.032).points
    assert wall[:, 0].max() == pytest.approx(0.468, abs=0.03)
    close = view_scan(np.full(360, -np.inf, np.float32), LDS01, reach=1.0)
    assert np.hypot(*close.points.T) == pytest.approx(0.12), "too close is an obstacle, not a miss"


@given(
    beams=st.integers(1, 900),
    angle_min=st.floats(-7.0, 7.0),
    opening=st.floats(0.1, TURN),
    clockwise=st.booleans(),
)
@example(beams=720, angle_min=0.0, opening=TURN, clockwise=True)
@settings(max_examples=200, deadline=None)
def test_each_direction_is_seen_by_the_beam_that_is_nearest_to_it(
    beams: int, angle_min: float, opening: float, clockwise: bool
) -> None:
    increment = (-1.0 if clockwise else 1.0) * opening / beams
    bearings = angle_min + increment * np.arange(beams)
    lit = np.arange(beams) % 2 == 0
    seen = view_scan(
        np.where(lit, 1.0, 0.0).astype(np.float32), ScanGeometry(beams, angle_min, increment, 0.1, 3.5), 2.0
    )
    directions = np.arange(DIRECTIONS) * TURN / DIRECTIONS
    apart = np.abs((directions[:, None] - bearings + math.pi) % TURN - math.pi)
    nearest = apart.min(axis=1)
    half = max(0.5 * abs(increment), math.pi / DIRECTIONS)
    sure = np.abs(nearest - half) > 1e-6
    assert (seen.field == (nearest <= half))[sure].all()
    alone = (apart <= apart.min(axis=1, keepdims=True) + 1e-6).sum(axis=1) == 1
    assert (seen.seen == lit[apart.argmin(axis=1)])[seen.field & alone & (apart.min(axis=1) < half - 1e-6)].all()


@given(
    v=st.floats(-0.3, 0.3),
    omega=st.floats(-3.0, 3.0),
    motion=st.floats(-0.3, 0.3),
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 40),
)
@example(v=-0.0625, omega=-2.5, motion=0.0, seed=0, count=3)  # a narrow arc, nearer between its ends
@settings(max_examples=400, deadline=None)
def test_what_is_allowed_leaves_room_to_brake_and_is_no_faster(
    v: float, omega: float, motion: float, seed: int, count: int
) -> None:
    """Simulate the allowed command in small steps: no point enters the disc, or gets closer to it."""
    random = np.random.default_rng(seed)
    bearing, distance = random.uniform(0.0, TURN, count), random.uniform(0.1, 0.8, count)
    points = np.column_stack((distance * np.cos(bearing), distance * np.sin(bearing)))
    command, problem = ROBOT.limit(np.array((v, omega)), points, motion, 0.1)
    assert abs(command[0]) <= abs(v)
    assert command[0] * v >= 0.0
    assert command[1] == omega
    assert (command[0] == 0.0) == (problem != "" or v == 0.0)
    if abs(command[0]) < 1e-3:
        return
    way = ROBOT.reach(abs(float(command[0])), 0.1)
    curvature, pose, steps = omega / command[0], np.zeros(3), 400
    before = np.hypot(*points.T)
    for _ in range(steps):
        step = math.copysign(way / steps, command[0])
        pose[2] += 0.5 * step * curvature
        pose[:2] += step * np.array((math.cos(pose[2]), math.sin(pose[2])))
        pose[2] += 0.5 * step * curvature
        now = np.hypot(*(points - pose[:2]).T)
        assert (now > np.minimum(before - 0.005, ROBOT.radius)).all(), "beyond the margin at most, never the robot"


@pytest.mark.fault
def test_before_an_obstacle_it_slows_then_stands_and_may_turn_away_or_back_off() -> None:
    safety = new()
    allowed = []
    for index, front in enumerate((1.0, 0.22, 0.19, 0.16)):
        see(safety, corridor(index, front), index)
        allowed.append(safety.limit(np.array((0.2, 0.3)), 0.0, 0.0))
    speeds = [float(command[0]) for command, _ in allowed]
    assert speeds[0] == 0.2
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] == 0.0
    command, problem = allowed[-1]
    assert "obstacle" in problem
    assert "ahead" in problem
    assert command.tolist() == [0.0, 0.3], "it may turn"
    assert safety.limit(np.array((-0.1, 0.0)), 0.0, 0.0)[1] == "", "and back off"
    near = new()
    see(near, corridor(9, 0.24), 0)
    assert near.limit(np.array((0.1, 0.0)), 0.0, 0.0)[1] == ""
    assert near.limit(np.array((0.1, 0.0)), 0.22, 0.0)[1] != "", "who comes quicker needs more room"
    assert near.limit(np.array((0.1, 0.0)), 0.0, 3.0)[1] != "", "so does an old scan"

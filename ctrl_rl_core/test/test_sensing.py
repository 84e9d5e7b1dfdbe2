"""Meaning of a robot's scans, odometry, poses and goals: the table of docs/sensing.md, row by row."""

import math
from types import SimpleNamespace as Message

import numpy as np
import pytest
from ctrl_rl_core.sensing.odometry_health import contradiction
from ctrl_rl_core.sensing.pose import planar
from ctrl_rl_core.sensing.scan import measured, view_scan

from ctrl_rl_core import (
    LiveOdometry,
    OdometryError,
    OdometryHealth,
    PoseError,
    ScanError,
    Sectors,
    make_odometry,
    read_goal,
    read_odometry,
    read_planar_pose,
    read_scan,
)

TURN = 2.0 * math.pi
STEP = TURN / 360
NAN, INF = math.nan, math.inf
WALL = 1.0
SECTORS = Sectors(tuple(np.deg2rad((-20.0, 0.0, 20.0)).tolist()), math.radians(4.0), 3.5)


def scan(ranges=None, **fields) -> Message:
    given = {"angle_min": 0.0, "angle_max": 359 * STEP, "angle_increment": STEP, "range_min": 0.12, "range_max": 3.5}
    given |= fields
    return Message(ranges=np.full(360, WALL, np.float32) if ranges is None else ranges, **given)


def odometry(
    position=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0, 1.0), linear=(0.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0), stamp=None
):
    vectors = [Message(x=v[0], y=v[1], z=v[2]) for v in (position, linear, angular)]
    pose = Message(position=vectors[0], orientation=Message(**dict(zip("xyzw", turn, strict=True))))
    twist = Message(linear=vectors[1], angular=vectors[2])
    return Message(header=Message(stamp=stamp), pose=Message(pose=pose), twist=Message(twist=twist))


@pytest.mark.parametrize(
    ("value", "meaning", "ahead"),
    [
        (2.0, 2.0, 2.0),
        (INF, INF, 3.5),
        (-INF, 0.12, 0.12),
        (NAN, NAN, WALL),
        (0.0, INF, 3.5),
        (0.05, NAN, WALL),
        (-1.0, NAN, WALL),
        (9.0, INF, 3.5),
    ],
)
def test_a_beam_means_one_thing_for_checks_and_policies(value: float, meaning: float, ahead: float) -> None:
    """All beams straight ahead have one value, between walls at 1 m."""
    ranges = np.full(360, WALL, np.float32)
    ranges[np.arange(-6, 7)] = value
    given, geometry = read_scan(scan(ranges))
    assert measured(given, geometry)[0] == pytest.approx(meaning, nan_ok=True)
    assert SECTORS.distances(given, geometry) == pytest.approx([WALL, ahead, WALL])
    assert Sectors(SECTORS.bearings, 0.0, 3.5, "least").distances(given, geometry) == pytest.approx([WALL, ahead, WALL])
    view = view_scan(given, geometry, INF)
    assert view.seen[0] == math.isfinite(meaning)
    assert len(view.points) == 360 - 13 * (not math.isfinite(meaning))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"angle_min": -math.pi, "angle_max": math.pi, "angle_increment": -STEP}, "360 ranges, and -359 by its angle"),
        ({"angle_min": math.pi, "angle_max": -math.pi}, "360 ranges, and -359 by its angle"),
        ({"angle_increment": 0.5 * STEP}, "360 ranges, and 719 by its angle"),
        ({"angle_max": math.pi}, "360 ranges, and 181 by its angle"),
        ({"angle_max": 0.0}, "360 ranges, and 1 by its angle"),
        ({"angle_max": NAN}, "360 ranges, and nan by its angle"),
        ({"angle_increment": 2.0 * STEP, "angle_max": 718 * STEP}, "over 718 deg: its angle_increment"),
        ({"angle_max": 359.0, "angle_increment": 1.0}, "over 20569 deg: .* is it in degrees"),
        ({"angle_min": -180.0, "angle_max": 179.0, "angle_increment": 1.0}, "angle_min -180.0"),
        ({"angle_increment": 0.0}, "angle_increment 0.0"),
        ({"angle_increment": NAN}, "angle_increment nan"),
        ({"angle_min": INF}, "angle_min inf"),
        ({"range_max": 0.05}, r"in 0.12 .. 0.05 m"),
        ({"range_min": NAN}, r"in nan .. 3.5 m"),
        ({"ranges": np.empty(0, np.float32)}, "scan with 0 ranges"),
    ],
)
def test_a_scan_of_contradictory_geometry_is_refused_by_checks_and_policies(fields: dict, message: str) -> None:
    ranges, geometry = read_scan(scan(**fields))
    with pytest.raises(ScanError, match=message):
        view_scan(ranges, geometry, INF)
    with pytest.raises(ScanError, match=message):
        SECTORS.distances(ranges, geometry)


@pytest.mark.parametrize(
    "fields",
    [
        {"angle_min": math.pi, "angle_max": math.pi - 359 * STEP, "angle_increment": -STEP},
        {"angle_max": TURN},
        {"angle_increment": TURN / 362.5},
    ],
    ids=["clockwise", "a beam too many", "a motor that is slower than it says"],
)
def test_what_real_lidars_send_is_taken(fields: dict) -> None:
    ranges, geometry = read_scan(scan(**fields), yaw=0.5)
    assert SECTORS.distances(ranges, geometry) == pytest.approx([WALL] * 3)


def test_a_scan_without_a_measurement_is_refused() -> None:
    with pytest.raises(ScanError, match="without any measurement"):
        SECTORS.distances(*read_scan(scan(np.full(360, np.nan, np.float32))))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"turn": (0.0, 0.0, 0.0, 0.0)}, "quaternion of length 0: must be 1"),
        ({"turn": (0.0, 0.0, 0.0, 2.0)}, "quaternion of length 2: must be 1"),
        ({"turn": (NAN, 0.0, 0.0, 1.0)}, "quaternion of length nan"),
        ({"position": (NAN, 0.0, 0.0)}, r"a translation of \[nan, 0.0, 0.0\] m"),
        ({"position": (0.0, 1e9, 0.0)}, "a translation of"),
    ],
)
def test_a_pose_that_is_none_is_refused_in_odometry_and_goals(fields: dict, message: str) -> None:
    wrong = odometry(**fields)
    with pytest.raises(PoseError, match=message):
        read_planar_pose(wrong.pose.pose)
    with pytest.raises(OdometryError, match=f"odometry with .*{message}"):
        read_odometry(wrong)


def test_a_goal_without_an_orientation_has_no_heading() -> None:
    goal = read_goal(odometry(position=(1.0, 2.0, 0.0), turn=(0.0, 0.0, 0.0, 0.0)).pose.pose)
    assert planar(goal.tolist()) == pytest.approx([1.0, 2.0, NAN], nan_ok=True)
    with pytest.raises(PoseError, match="quaternion of length 2"):
        read_goal(odometry(turn=(0.0, 0.0, 0.0, 2.0)).pose.pose)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"linear": (NAN, 0.0, 0.0)}, "odometry with speed nan and turn rate 0.0"),
        ({"angular": (0.0, 0.0, INF)}, "odometry with speed 0.0 and turn rate inf"),
        ({"linear": (0.0, NAN, 0.0)}, "odometry with a twist of"),
        ({"linear": (1e300, 0.0, 0.0)}, "odometry with a twist of"),
    ],
)
def test_a_twist_that_is_none_is_refused(fields: dict, message: str) -> None:
    with pytest.raises(OdometryError, match=message):
        read_odometry(odometry(**fields))


def drive(v: float, omega: float, told: tuple[float, float], seconds: float = 3.0, rate: float = 20.0):
    """Return stamps, poses and reported speeds of a drive at constant speeds."""
    times = np.arange(0.0, seconds, 1.0 / rate)
    yaw = 0.7 + omega * times
    way = np.cumsum(np.full(len(times), v / rate))
    poses = np.column_stack((way * math.cos(0.7), way * math.sin(0.7), yaw))
    return np.round(1e9 * (100.0 + times)).astype(np.int64), poses, np.tile(told, (len(times), 1)).astype(float)


@pytest.mark.parametrize(
    ("v", "omega", "told", "message"),
    [
        (0.2, 0.0, (0.2, 0.0), ""),
        (0.2, 0.0, (0.15, 0.0), ""),
        (0.0, 0.0, (0.2, 0.0), ""),
        (0.2, 0.0, (1e-12, 0.0), "in its pose, of which its speeds explain 0.00 m"),
        (0.2, 0.0, (-0.2, 0.0), "explain -0"),
        (0.0, 1.0, (0.0, 1.0), ""),
        (0.0, 1.0, (0.0, 0.0), "of which its turn rates explain 0.00 rad"),
        (0.0, 1.0, (0.0, -1.0), "turn rates explain -"),
    ],
)
def test_a_twist_must_explain_how_the_pose_moves(v: float, omega: float, told: tuple, message: str) -> None:
    found = contradiction(*drive(v, omega, told))
    assert message in found
    assert bool(found) == bool(message)


def test_a_jump_of_the_pose_is_no_motion() -> None:
    stamps, poses, speeds = drive(0.2, 0.0, (0.2, 0.0))
    for jump in (0.15, 5.0):
        moved = poses.copy()
        moved[30:, 0] += jump
        assert not contradiction(stamps, moved, speeds)


def test_a_contradiction_holds_until_the_twist_is_right_again() -> None:
    health = OdometryHealth()
    for told, faulty in ((0.0, True), (0.2, False)):
        stamps, poses, _ = drive(0.2, 0.0, (0.0, 0.0))
        for stamp, pose in zip(stamps.tolist(), poses, strict=True):
            health.update(stamp, make_odometry(pose, np.array((told, 0.0, 0.0))))
        assert bool(health.fault) is faulty
    for stamp in range(5):
        health.update(10**12 + stamp * 10**8, make_odometry(np.zeros(3), np.zeros(3)))
    assert not health.fault


def told(live: LiveOdometry, stamp: int, pose: np.ndarray, v: float = 0.0, z: float = 0.0) -> list[float]:
    """Return forward speed, speed to the left and turn rate that are read from a message."""
    x, y, yaw = pose
    turn = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
    at = Message(sec=stamp // 10**9, nanosec=stamp % 10**9)
    return live.read(odometry((x, y, z), turn, (v, 0.0, 0.0), stamp=at))[[7, 8, 12]].tolist()


@pytest.mark.fault
@pytest.mark.parametrize(("v", "omega"), [(0.2, 0.0), (-0.1, 0.0), (0.0, 1.0)])
def test_where_every_twist_is_zero_the_pose_tells_the_speeds(v: float, omega: float) -> None:
    live = LiveOdometry()
    stamps, poses, _ = drive(v, omega, (0.0, 0.0))
    speeds = np.array([told(live, *row, v=1e-12) for row in zip(stamps.tolist(), poses, strict=True)])
    assert speeds[0].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(speeds[1:], np.tile((v, 0.0, omega), (len(stamps) - 1, 1)), atol=1e-6)
    assert not live.fault
    assert live.lacks_twist is bool(v)
    assert told(live, int(stamps[-1]) + 10**8, poses[-1] + (5.0, 5.0, 0.0)) == [0.0, 0.0, 0.0], "another origin"


def test_a_twist_that_was_there_is_held_to_the_pose() -> None:
    live = LiveOdometry()
    stamps, poses, _ = drive(0.2, 0.0, (0.0, 0.0))
    assert told(live, int(stamps[0]), poses[0], v=0.2)[0] == 0.2
    assert [told(live, *row)[0] for row in zip(stamps[1:].tolist(), poses[1:], strict=True)] == [0.0] * 59
    assert "of which its speeds explain" in live.fault
    assert not live.lacks_twist


def test_a_robot_that_climbs_without_a_twist_is_a_contradiction() -> None:
    live, stamps = LiveOdometry(), drive(0.0, 0.0, (0.0, 0.0))[0].tolist()
    for number, stamp in enumerate(stamps):
        told(live, stamp, np.zeros(3), z=0.01 * number)
    assert "of which its speeds explain 0.00 m" in live.fault

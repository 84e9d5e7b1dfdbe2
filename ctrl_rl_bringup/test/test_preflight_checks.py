"""The checks of the pre-flight, each on data that a robot with one fault would send."""

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from ctrl_rl_bringup.preflight import frame_checks, robot_checks, scan_checks, topic_checks
from ctrl_rl_bringup.preflight.finding import Finding, Level, Limits
from ctrl_rl_bringup.preflight.frames import FrameTree, Link, planar_pose, pose_matrix
from ctrl_rl_bringup.preflight.inspection import as_text, inspect_standing, may_go, verdict
from ctrl_rl_bringup.preflight.recording import Battery, Endpoint, OdometrySample, Recording, ScanSample, Times, Topic
from ctrl_rl_core.navigation import OCCUPIED
from ctrl_rl_core.ros import LATCHED
from rclpy.qos import DurabilityPolicy, QoSProfile

from ctrl_rl_core import COMMAND, SENSOR, OccupancyMap, ScanGeometry

LIMITS = Limits()
BEAMS = 360
SCAN, ODOM, STAMPED = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "geometry_msgs/msg/TwistStamped"
TRANSIENT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def room(x: float = 0.0, y: float = 0.0) -> np.ndarray:
    """Return the ranges in a square room of 4 m, seen from a place in it."""
    angles = np.arange(BEAMS) * 2.0 * np.pi / BEAMS
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        ways = [(2.0 * sign - place) / part for place, part in ((x, c), (y, s)) for sign in (-1.0, 1.0)]
    return np.min([np.where(way > 0.0, way, np.inf) for way in ways], axis=0).astype(np.float32)


def scan(number: int, ranges: np.ndarray | None = None, **changes: object) -> ScanSample:
    geometry = ScanGeometry(BEAMS, 0.0, 2.0 * math.pi / BEAMS, 0.12, 3.5)
    noise = np.random.default_rng(number).normal(0.0, 0.01, BEAMS).astype(np.float32)
    seen = room() + noise if ranges is None else ranges
    sample = ScanSample(Times(0.2 * number, 0.01, 100.0 + 0.2 * number), "base_scan", seen, geometry)
    return replace(sample, **changes)


def odometry(number: int, **changes: object) -> OdometrySample:
    times = Times(number / 30.0, 0.01, 100.0 + number / 30.0)
    sample = OdometrySample(times, "odom", "base_footprint", (0.0, 0.0, 0.0), (0.0, 0.0))
    return replace(sample, **changes)


def link(parent: str, child: str, x: float = 0.0, yaw: float = 0.0, roll: float = 0.0, age: float = 0.0) -> Link:
    c, s = math.cos(0.5 * roll), math.sin(0.5 * roll)
    rotation = (s * math.cos(0.5 * yaw), s * math.sin(0.5 * yaw), c * math.sin(0.5 * yaw), c * math.cos(0.5 * yaw))
    matrix = pose_matrix((x, 0.0, 0.1), rotation)
    assert matrix is not None
    return Link(parent, child, matrix, age, static=parent != "odom")


def tree(*links: Link) -> FrameTree:
    out = FrameTree()
    for each in links or (link("odom", "base_footprint"), link("base_footprint", "base_scan", x=-0.032)):
        out.add(each)
    return out


def walls() -> OccupancyMap:
    """Return a map of the room."""
    cells = np.zeros((82, 82), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = OCCUPIED
    return OccupancyMap(cells, 0.05, (-2.05, -2.05, 0.0))


def topics(**changes: Topic) -> dict[str, Topic]:
    lidar, base = Endpoint("/lidar", SCAN, SENSOR), Endpoint("/base", ODOM, COMMAND)
    return {
        "scan": Topic("/scan", publishers=(lidar,)),
        "odom": Topic("/odom", publishers=(base,)),
        "cmd_vel": Topic("/cmd_vel", subscribers=(Endpoint("/base", STAMPED, COMMAND),)),
    } | changes


def healthy(**changes: object) -> Recording:
    """Return what a healthy robot tells in two seconds, with some fields changed."""
    base = {
        "begin": -0.05,
        "end": 2.05,
        "scans": deque(scan(number) for number in range(11)),
        "odometry": deque(odometry(number) for number in range(61)),
        "battery": Battery(0.8, 12.0),
        "frames": tree(),
        "topics": topics(),
    }
    return Recording(**(base | changes))


Check = Callable[[Recording, Limits], Iterator[Finding]]


def the_finding(check: Check, heard: Recording, limits: Limits = LIMITS) -> Finding:
    """Return the worst finding of a check."""
    order = [Level.NO_GO, Level.NOTE, Level.LEFT_OUT, Level.OK]
    return min(check(heard, limits), key=lambda finding: order.index(finding.level))


def test_a_healthy_robot_may_go() -> None:
    findings = inspect_standing(healthy(), LIMITS)
    assert may_go(findings), as_text(findings)
    assert {finding.level for finding in findings} == {Level.OK, Level.LEFT_OUT}
    assert verdict(findings).startswith("GO: ")


def test_a_robot_that_says_nothing_may_not_go_and_breaks_no_check() -> None:
    findings = inspect_standing(Recording(), LIMITS)
    assert not may_go(findings)
    assert "start the robot's bringup" in as_text(findings)


def changed(samples: deque, **changes: object) -> deque:
    return deque(replace(each, **changes) for each in samples)


def with_ranges(change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    return healthy(scans=deque(replace(each, ranges=change(each.ranges)) for each in healthy().scans))


def with_times(**changes: object) -> Recording:
    heard = healthy()
    for each in (heard.scans, heard.odometry):
        for index, sample in enumerate(each):
            each[index] = replace(sample, times=sample.times._replace(**changes))
    return heard


def with_topic(name: str, publishers: tuple = (), subscribers: tuple = ()) -> Recording:
    return healthy(topics=topics(**{name: Topic(f"/{name}", publishers, subscribers)}))


NO_GO = [
    (topic_checks.check_sensors, with_topic("scan"), "nobody publishes /scan"),
    (topic_checks.check_sensors, healthy(scans=deque()), "but nothing arrives"),
    (topic_checks.check_sensors, with_topic("scan", (Endpoint("/x", "a/msg/B", SENSOR),)), "published as a/msg/B"),
    (topic_checks.check_single_source, with_topic("scan", (Endpoint("/a", SCAN, SENSOR),) * 2), "/a (2 times)"),
    (
        topic_checks.check_single_source,
        healthy(scans=deque((scan(0), scan(1, frame="other")))),
        "scans of different lidars",
    ),
    (topic_checks.check_command_type, with_topic("cmd_vel"), "nobody listens to /cmd_vel"),
    (
        topic_checks.check_command_type,
        with_topic("cmd_vel", subscribers=(Endpoint("/base", "geometry_msgs/msg/Twist", COMMAND),)),
        "as geometry_msgs/msg/Twist, commands are geometry_msgs/msg/TwistStamped",
    ),
    (topic_checks.check_command_type, healthy(unstamped=True), "commands are geometry_msgs/msg/Twist"),
    (
        topic_checks.check_qos,
        with_topic("cmd_vel", subscribers=(Endpoint("/base", STAMPED, TRANSIENT),)),
        "/base never hears commands",
    ),
    (topic_checks.check_qos, with_topic("map", (Endpoint("/maps", "m", COMMAND),)), "/maps publishes on /map"),
    (topic_checks.check_commanders, with_topic("cmd_vel", (Endpoint("/teleop", STAMPED, COMMAND),)), "/teleop"),
    (topic_checks.check_rates, healthy(scans=deque(list(healthy().scans)[::5])), "at least 4 Hz"),
    (topic_checks.check_rates, healthy(odometry=deque(list(healthy().odometry)[:30])), "longest gap"),
    (topic_checks.check_stamps, with_times(age=5.0), "5.00 s behind this computer's clock"),
    (topic_checks.check_stamps, with_times(age=-60.0), "60.00 s ahead"),
    (topic_checks.check_stamps, with_times(stamp=7.0), "stamps are not later"),
    (frame_checks.check_names, healthy(scans=changed(healthy().scans, frame="")), "scan has no frame"),
    (frame_checks.check_tree, healthy(frames=tree(link("odom", "base_footprint"))), "base_footprint to base_scan"),
    (frame_checks.check_tree, healthy(frames=tree(link("base_footprint", "base_scan"))), "odom to base_footprint"),
    (
        frame_checks.check_tree,
        healthy(frames=tree(*tree(), link("ekf", "base_footprint"))),
        "two parents: ekf and odom",
    ),
    (
        frame_checks.check_tree,
        healthy(frames=tree(link("odom", "base_footprint", age=3.0), link("base_footprint", "base_scan"))),
        "is 3.00 s behind the clock",
    ),
    (
        frame_checks.check_odometry_agrees,
        healthy(frames=tree(link("odom", "base_footprint", x=0.5))),
        "differ by 0.50 m",
    ),
    (frame_checks.check_mounting, healthy(frames=tree(link("base_footprint", "base_scan", -0.03, 1.57))), "1.57 rad"),
    (frame_checks.check_mounting, healthy(frames=tree(link("base_footprint", "base_scan", 0.1))), "0.100 m ahead"),
    (
        frame_checks.check_mounting,
        healthy(frames=tree(link("base_footprint", "base_scan", -0.032, roll=math.pi))),
        "upside-down",
    ),
    (
        scan_checks.check_beams,
        healthy(scans=deque((scan(0, geometry=ScanGeometry(0, 0.0, 0.1, 0.1, 3.5)),))),
        "0 ranges",
    ),
    (
        scan_checks.check_beams,
        healthy(scans=deque((scan(0, geometry=ScanGeometry(BEAMS, 0.0, 0.001, 0.1, 3.5)),))),
        "over 21 deg",
    ),
    (scan_checks.check_echoes, with_ranges(np.zeros_like), "0 % of the beams have an echo (100 % zero)"),
    (scan_checks.check_echoes, with_ranges(lambda each: np.full_like(each, np.nan)), "100 % NaN"),
    (
        scan_checks.check_echoes,
        with_ranges(lambda each: np.where(np.abs(np.arange(BEAMS) - 180) > 140, np.inf, each)),
        "none within 30 deg ahead",
    ),
    (scan_checks.check_frozen, healthy(scans=deque(scan(number, room()) for number in range(9))), "8 of 9 scans"),
    (
        robot_checks.check_odometry,
        healthy(odometry=changed(healthy().odometry, fault="odometry with a quaternion of length 0: must be 1")),
        "61 of 61 messages are refused: odometry with a quaternion of length 0",
    ),
    (robot_checks.check_odometry, healthy(odometry=changed(healthy().odometry, twist=(0.2, 0.0))), "moves: 0.20 m/s"),
    (robot_checks.check_battery, healthy(battery=Battery(0.08, 12.0)), "8 %"),
    (robot_checks.check_battery, healthy(battery=Battery(math.nan, 10.4)), "10.4 V"),
    (robot_checks.check_map, healthy(map=("map", walls())), "no pose of base_footprint in map"),
    (robot_checks.check_map, healthy(map_fault="no cells"), "no cells"),
    (
        robot_checks.check_map,
        healthy(map=("map", walls()), map_pose=("map", (0.6, 0.6, 0.3))),
        "% of the echoes lie within 0.15 m",
    ),
]


@pytest.mark.parametrize(("check", "heard", "words"), NO_GO, ids=lambda each: each if isinstance(each, str) else "")
def test_a_fault_is_a_no_go_with_its_reason_and_what_to_do(check: Check, heard: Recording, words: str) -> None:
    finding = the_finding(check, heard)
    assert finding.level is Level.NO_GO
    assert words in finding.text
    assert finding.advice


FINE = [
    (topic_checks.check_command_type, with_topic("cmd_vel", (), (Endpoint("/b", STAMPED, COMMAND),)), "TwistStamped"),
    (topic_checks.check_qos, with_topic("map", (Endpoint("/maps", "m", LATCHED),)), "all that publish"),
    (robot_checks.check_battery, healthy(battery=Battery(math.nan, 11.8)), "11.8 V"),
    (robot_checks.check_battery, healthy(battery=Battery(0.0, 11.8)), "11.8 V"),
    (robot_checks.check_map, healthy(map=("map", walls()), map_pose=("map", (0.0, 0.0, 0.0))), "99 %"),
    (
        robot_checks.check_map,
        healthy(map=("map", walls()), frames=tree(*tree(), link("map", "odom"))),
        "99 %",
    ),
]


@pytest.mark.parametrize(("check", "heard", "words"), FINE, ids=lambda each: each if isinstance(each, str) else "")
def test_what_is_right_passes(check: Check, heard: Recording, words: str) -> None:
    finding = the_finding(check, heard)
    assert finding.level is Level.OK
    assert words in finding.text


def test_under_a_watchdog_only_the_watchdog_may_publish_the_robots_commands() -> None:
    watchdog, teleop = Endpoint("/watchdog", STAMPED, COMMAND), Endpoint("/teleop", STAMPED, COMMAND)
    raw = Topic("/cmd_vel_raw", (), (watchdog,))
    good = healthy(command_topic="cmd_vel_raw", topics=topics(cmd_vel_raw=raw, cmd_vel=Topic("/cmd_vel", (watchdog,))))
    assert the_finding(topic_checks.check_commanders, good).level is Level.OK
    both = Topic("/cmd_vel", (watchdog, teleop))
    bad = healthy(command_topic="cmd_vel_raw", topics=topics(cmd_vel_raw=raw, cmd_vel=both))
    assert "/teleop publishes /cmd_vel" in the_finding(topic_checks.check_commanders, bad).text
    past = with_topic("cmd_vel", (watchdog,), (Endpoint("/base", STAMPED, COMMAND),))
    assert "--commands cmd_vel_raw" in the_finding(topic_checks.check_commanders, past).advice


def test_a_lidar_that_the_controllers_are_told_of_may_be_turned() -> None:
    heard = healthy(frames=tree(link("base_footprint", "base_scan", -0.032, 1.57)))
    assert the_finding(frame_checks.check_mounting, heard, Limits(lidar_yaw=1.5708)).level is Level.OK


def test_frames_connect_through_ancestors_and_circles_end() -> None:
    frames = tree(link("map", "odom", x=1.0), link("odom", "base", yaw=0.5 * math.pi), link("base", "scan", x=0.2))
    pose = frames.between("map", "scan")
    assert pose is not None
    assert planar_pose(pose) == pytest.approx((1.0, 0.2, 0.5 * math.pi))
    back = frames.between("scan", "map")
    assert back is not None
    assert back @ pose == pytest.approx(np.eye(4))
    assert frames.between("map", "nowhere") is None
    circle = tree(link("a", "b"), link("b", "a"))
    assert circle.between("a", "c") is None


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0)])
def test_a_transform_that_is_none_is_refused(rotation: tuple[float, float, float, float]) -> None:
    assert pose_matrix((0.0, 0.0, 0.0), rotation) is None

"""Transforms by time and the pose on the map: chains, interpolation, ages, and invalid input."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_core.navigation.pose_source import LocaliserPose, OdometryTrack, TransformPose
from ctrl_rl_core.navigation.transform_tree import Transform, TransformError, TransformTree
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial import cKDTree
from tf2_msgs.msg import TFMessage

coordinates = st.floats(-10.0, 10.0)
transforms = st.builds(
    lambda place, turn: Transform(np.array(place), np.array(turn) / np.linalg.norm(turn)),
    st.tuples(coordinates, coordinates, coordinates),
    st.tuples(coordinates, coordinates, coordinates, coordinates).filter(lambda q: np.linalg.norm(q) > 0.1),
)
SECOND = 10**9


def planar(x: float, y: float, yaw: float) -> Transform:
    return Transform.planar(x, y, yaw)


def matrix(transform: Transform) -> np.ndarray:
    x, y, z, w = transform.rotation
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, 3] = transform.translation
    return out


@given(transforms, transforms)
def test_products_and_inverses_are_those_of_matrices(one: Transform, other: Transform) -> None:
    assert matrix(one @ other) == pytest.approx(matrix(one) @ matrix(other), abs=1e-9)
    assert matrix(one.inverse()) == pytest.approx(np.linalg.inv(matrix(one)), abs=1e-9)
    assert matrix(one.between(other, 0.0)) == pytest.approx(matrix(one), abs=1e-6)
    assert matrix(one.between(other, 1.0)) == pytest.approx(matrix(other), abs=1e-6)


@pytest.fixture
def tree() -> TransformTree:
    tree = TransformTree()
    tree.set("map", "odom", planar(1.0, 0.0, math.pi / 2), 0, 100.0)
    for second in range(3):
        tree.set("odom", "base", planar(second, 0.0, 0.2 * second), second * SECOND, 100.0 + second)
    tree.set("base", "lidar", planar(0.1, 0.0, 0.0), 0, 90.0, fixed=True)
    return tree


def test_a_chain_is_looked_up_both_ways_and_between_stamps(tree: TransformTree) -> None:
    assert tree.lookup("map", "base").pose == pytest.approx((1.0, 2.0, math.pi / 2 + 0.4))
    assert tree.lookup("odom", "lidar", SECOND // 2).pose == pytest.approx(
        (0.5 + 0.1 * math.cos(0.1), 0.1 * math.sin(0.1), 0.1)
    )
    there, back = tree.lookup("odom", "lidar"), tree.lookup("/lidar", "/odom")
    assert matrix(there @ back) == pytest.approx(np.eye(4), abs=1e-12)
    assert tree.lookup("base", "base").pose == pytest.approx((0.0, 0.0, 0.0))
    assert tree.lookup("odom", "base", round(2.3 * SECOND)).pose == pytest.approx((2.0, 0.0, 0.4))


def test_a_missing_or_old_link_is_said_in_one_line(tree: TransformTree) -> None:
    with pytest.raises(TransformError, match=r"no transform from 'map' to 'wheel' \(heard of 'map' alone\)"):
        tree.lookup("map", "wheel")
    tree.set("world", "drone", planar(0.0, 0.0, 0.0), 0, 0.0)
    with pytest.raises(TransformError, match="they lie in two trees"):
        tree.lookup("map", "drone")
    with pytest.raises(TransformError, match=r"from 'odom' to 'base' was asked 5\.0 s after the last"):
        tree.lookup("odom", "base", 7 * SECOND)
    assert tree.age("map", "lidar", 105.0) == pytest.approx(5.0)
    assert tree.age("base", "lidar", 105.0) == 0.0


def test_a_simulation_that_begins_anew_is_followed_and_old_samples_go(tree: TransformTree) -> None:
    tree.set("odom", "base", planar(50.0, 0.0, 0.0), 100 * SECOND, 200.0)
    assert tree.lookup("odom", "base").pose[0] == 50.0
    tree.set("odom", "base", planar(7.0, 0.0, 0.0), 0, 201.0)
    assert tree.lookup("odom", "base").pose[0] == 7.0
    tree.set("map", "base", planar(3.0, 0.0, 0.0), 0, 202.0)  # another parent
    assert tree.lookup("map", "base").pose[0] == 3.0


def test_wrong_transforms_are_refused_and_change_nothing(tree: TransformTree) -> None:
    def message(parent: str, child: str, x: float, w: float) -> TFMessage:
        out = TransformStamped(child_frame_id=child)
        out.header.frame_id = parent
        out.transform.translation.x, out.transform.rotation.w = x, w
        return TFMessage(transforms=[out])

    assert tree.update(message("odom", "base", 4.0, 1.0), 103.0) == ""
    assert "translation" in tree.update(message("odom", "base", math.nan, 1.0), 103.0)
    assert "quaternion of length 0" in tree.update(message("odom", "base", 1.0, 0.0), 103.0)
    assert "no name" in tree.update(message("", "base", 1.0, 1.0), 103.0)
    assert "cycle" in tree.update(message("lidar", "map", 1.0, 1.0), 103.0)
    assert "cycle" in tree.update(message("lidar", "base", 1.0, 1.0), 103.0)
    for number in range(1100):
        refused = tree.update(message("odom", f"frame_{number}", 1.0, 1.0), 103.0)
    assert "more than 1000 frames" in refused
    assert tree.lookup("map", "base").translation[:2] == pytest.approx((1.0, 2.0))


def odometry(second: float, x: float, yaw: float = 0.0) -> Odometry:
    out = Odometry(child_frame_id="base")
    out.header.frame_id = "odom"
    out.header.stamp.sec, out.header.stamp.nanosec = int(second), round(1e9 * (second % 1.0))
    out.pose.pose.position.x = x
    out.pose.pose.orientation.z, out.pose.pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    return out


def test_the_pose_from_transforms_needs_recent_ones(tree: TransformTree) -> None:
    source = TransformPose(tree, "map", 2.0)
    with pytest.raises(TransformError, match="no odometry yet"):
        source.pose(100.0)
    source.base = "base"
    assert source.pose(102.0) == pytest.approx((1.0, 2.0, math.pi / 2 + 0.4))
    with pytest.raises(TransformError, match=r"from 'map' to 'base' is 3\.0 s old"):
        source.pose(103.0)
    assert source.frame_in_map("odom").pose == pytest.approx((1.0, 0.0, math.pi / 2))


def test_a_localisers_pose_is_moved_on_by_odometry_for_some_way() -> None:
    track = OdometryTrack()
    source = LocaliserPose(track, "map", 1.0)
    with pytest.raises(TransformError, match="no odometry yet"):
        source.pose(0.0)
    for tenth in range(11):
        track.update(odometry(0.1 * tenth, 0.1 * tenth), 10.0)
    with pytest.raises(TransformError, match="no amcl_pose yet"):
        source.pose(10.0)
    pose = PoseWithCovarianceStamped()
    pose.header.frame_id, pose.header.stamp.nanosec = "map", 550_000_000
    pose.pose.pose.position.y, pose.pose.pose.orientation.z, pose.pose.pose.orientation.w = (
        2.0,
        math.sqrt(0.5),
        math.sqrt(0.5),
    )
    source.on_pose(pose)
    assert source.pose(10.0) == pytest.approx((0.0, 2.45, math.pi / 2))
    assert source.frame_in_map("odom").pose == pytest.approx((0.0, 1.45, math.pi / 2))
    with pytest.raises(TransformError, match="frame 'base' is unknown"):
        source.frame_in_map("base")
    with pytest.raises(TransformError, match=r"the odometry is 2\.0 s old"):
        source.pose(12.0)
    track.update(odometry(2.0, 5.0), 12.0)
    with pytest.raises(TransformError, match=r"no amcl_pose for 4\.5 m"):
        source.pose(12.0)
    pose.header.frame_id = "odom"
    with pytest.raises(TransformError, match="must be in 'map'"):
        source.on_pose(pose)
    with pytest.raises(TransformError, match="translation"):
        track.update(odometry(3.0, math.inf), 13.0)


def test_scans_of_a_real_drive_agree_where_its_transforms_put_them(real_drive: Path) -> None:
    tree, scans = TransformTree(memory=100.0), []
    with AnyReader([real_drive], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
        names = ("/tf", "/tf_static", "/scan")
        for connection, time, raw in bag.messages([each for each in bag.connections if each.topic in names]):
            message = bag.deserialize(raw, connection.msgtype)
            if connection.topic == "/scan":
                scans.append(message)
            else:
                assert tree.update(message, 1e-9 * time, connection.topic == "/tf_static") == ""
    placed, poses = [], []
    for scan in scans[20:-20:10]:
        pose = tree.lookup("odom", scan.header.frame_id, scan.header.stamp.sec * SECOND + scan.header.stamp.nanosec)
        ranges = np.asarray(scan.ranges)
        seen = (ranges > scan.range_min) & (ranges < 4.0)
        bearings = (scan.angle_min + scan.angle_increment * np.arange(len(ranges)))[seen]
        rays = np.column_stack((np.cos(bearings), np.sin(bearings), np.zeros(len(bearings)))) * ranges[seen, None]
        placed.append((rays @ matrix(pose)[:3, :3].T + pose.translation)[:, :2])
        poses.append(pose.pose)
    assert len(placed) > 20
    assert np.ptp(np.array(poses)[:, :2], axis=0).max() > 1.0  # the robot drove
    apart = [np.median(cKDTree(one).query(other)[0]) for one, other in pairwise(placed)]
    assert np.median(apart) < 0.05


def quarrel(*publishers: tuple[str, float], count: int = 20, rate: float = 20.0) -> TransformTree:
    """Return a tree in which publishers alternately report the base, with their parent and x."""
    tree = TransformTree()
    tree.set("map", "odom", planar(0.0, 0.0, 0.0), 0, 0.0, fixed=True)
    for number in range(count):
        parent, x = publishers[number % len(publishers)]
        now = number / rate
        tree.set(parent, "base", planar(x + 0.2 * now, 0.0, 0.0), round(now * SECOND), now)
    return tree


@pytest.mark.fault
def test_two_publishers_of_one_transform_leave_the_pose_unknown() -> None:
    tree = quarrel(("odom", 0.0), ("odom", 0.0), ("odom", 0.8))
    source = TransformPose(tree, "map", 2.0)
    source.base = "base"
    with pytest.raises(
        TransformError, match=r"'odom' to 'base' jumps by 0\.\d\d m to and fro: do two nodes publish it"
    ):
        source.pose(1.0)
    for number in range(60):
        tree.set("odom", "base", planar(0.2, 0.0, 0.0), (number + 25) * SECOND // 20, 1.0 + number / 20)
    assert source.pose(4.0)[0] == pytest.approx(0.2), "one of them has gone"


@pytest.mark.fault
def test_a_frame_with_two_parents_leaves_the_pose_unknown() -> None:
    source = TransformPose(quarrel(("odom", 0.0), ("map", 0.6)), "map", 2.0)
    source.base = "base"
    with pytest.raises(TransformError, match="'base' has two parents: 'map' and 'odom'"):
        source.pose(1.0)


def test_a_correction_and_a_robot_that_turns_back_are_no_contradiction() -> None:
    tree = quarrel(("odom", 0.0))
    tree.set("odom", "base", planar(3.0, 1.0, 2.0), 2 * SECOND, 1.1)
    assert tree.contradiction("map", "base", 1.2) == ""
    for number in range(200):
        now = 2.0 + number / 20
        tree.set("odom", "base", planar(0.1 * math.sin(now), 0.0, 0.5 * math.sin(5.0 * now)), round(now * SECOND), now)
        assert tree.contradiction("map", "base", now) == ""

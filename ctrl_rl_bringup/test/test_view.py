"""The page's parts without a browser: the scene from a bag, shapes, tokens, and what the command refuses."""

import math
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import send_as_intruder
from commands import check_refused
from ctrl_rl_bringup.view.access import MOST_WRONG, SPAN_S, Access, TokenError
from ctrl_rl_bringup.view.recorded import Recording
from ctrl_rl_bringup.view.scene import MOST_NOTES, Scene, Surface
from ctrl_rl_bringup.view.shapes import boxes_mesh, floor_of, funnel_of
from ctrl_rl_bringup.view.value_slice import ValueSlice
from ctrl_rl_core.ros import to_stamp
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import serialize_message
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from ctrl_rl_bags import BagError, BagWriter, Topic, message_definition, open_bag
from ctrl_rl_core import Axis, Box, OccupancyMap, ValueGrid, find_robot
from ctrl_rl_msgs.msg import NavigatorStatus, SafetyStatus

ROBOT = find_robot("turtlebot3_burger")
WITH_VISER = pytest.mark.skipif(find_spec("viser") is None, reason="viser is not installed: requirements/view.txt")
S = 10**9
TYPES = {
    "map": "nav_msgs/msg/OccupancyGrid",
    "odom": "nav_msgs/msg/Odometry",
    "scan": "sensor_msgs/msg/LaserScan",
    "path": "nav_msgs/msg/Path",
    "cmd_vel": "geometry_msgs/msg/TwistStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "navigator/status": "ctrl_rl_msgs/msg/NavigatorStatus",
    "safety_filter/status": "ctrl_rl_msgs/msg/SafetyStatus",
}


def odometry(x: float, time: int) -> Odometry:
    out = Odometry(child_frame_id="base_footprint")
    out.header.frame_id, out.header.stamp = "odom", to_stamp(time)
    out.pose.pose.position.x, out.pose.pose.orientation.w = x, 1.0
    return out


def transform(parent: str, child: str, x: float, yaw: float, time: int) -> TFMessage:
    out = TransformStamped(child_frame_id=child)
    out.header.frame_id, out.header.stamp = parent, to_stamp(time)
    out.transform.translation.x = x
    out.transform.rotation.z, out.transform.rotation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    return TFMessage(transforms=[out])


def scan(distance: float, time: int) -> LaserScan:
    out = LaserScan(angle_min=0.0, angle_max=1.5 * math.pi, angle_increment=0.5 * math.pi, range_min=0.1, range_max=3.5)
    out.header.frame_id, out.header.stamp = "base_scan", to_stamp(time)
    out.ranges = [distance, math.inf, math.inf, math.nan]
    return out


def drive() -> list[tuple[int, str, Any]]:
    """Return ten seconds of a robot that drives along x at 0.1 m/s; the map's frame is turned by a right angle."""
    floor = OccupancyMap(np.zeros((20, 40), np.int8), 0.1).to_message(to_stamp(0), "map")
    path, pose = PathMessage(), PoseStamped()
    path.header.frame_id, pose.pose.position.x = "map", 2.0
    path.poses = [PoseStamped(), pose]
    status = DiagnosticStatus(name="/lidar", level=DiagnosticStatus.WARN, message="<b>hot</b>")
    out = [
        (0, "map", floor),
        (0, "/tf_static", transform("map", "odom", 1.0, 0.5 * math.pi, 0)),
        (3 * S, "path", path),
    ]
    for tenth in range(100):
        time = tenth * S // 10
        out.append((time, "odom", odometry(0.01 * tenth, time)))
        out.append((time, "/tf", transform("odom", "base_footprint", 0.01 * tenth, 0.0, time)))
        out.append((time, "scan", scan(1.0, time)))
        command = TwistStamped()
        command.twist.linear.x = 0.1
        out.append((time, "cmd_vel", command))
        if tenth % 10 == 0:
            out.append((time, "/diagnostics", DiagnosticArray(status=[status])))
    told = NavigatorStatus(state=NavigatorStatus.DRIVING, message="driving", remaining_time=4.0)
    told.goal.position.x = 2.0
    answer = SafetyStatus(mode=SafetyStatus.CORRECTED, why="a wall", raw_speed=0.2, speed=0.05)
    return [*out, (5 * S, "navigator/status", told), (6 * S, "safety_filter/status", answer)]


def write(folder: Path, messages: list[tuple[int, str, Any]], namespace: str = "") -> Path:
    """Write a bag of messages, given by time, topic and content."""
    with BagWriter(folder) as writer:
        full = {name: name if name.startswith("/") else f"{namespace}/{name}" for name in TYPES}
        for name in sorted({name for _, name, _ in messages}):
            writer.add_topic(Topic(full[name], TYPES[name], message_definition(TYPES[name])))
        for time, name, message in sorted(messages, key=lambda each: each[0]):
            writer.write(full[name], serialize_message(message), log_time=S + time)
    return folder


@pytest.mark.parametrize("namespace", ["", "/robot_1"])
def test_a_bag_shows_the_scene_at_each_of_its_times(tmp_path: Path, namespace: str) -> None:
    with open_bag(write(tmp_path / "bag", drive(), namespace)) as bag:
        recording = Recording(bag, ROBOT, namespace)
        scene = recording.scene
        assert recording.duration == pytest.approx(9.9)
        assert scene.map is not None
        assert len(scene.path) == 0
        recording.seek(4.0)
        assert scene.pose == pytest.approx((1.0, 0.4, 0.5 * math.pi), abs=0.011)
        assert "pose" not in scene.notes
        # The echo lies a metre ahead of the lidar, which the robot's file mounts behind its centre.
        assert scene.scan == pytest.approx(np.array([(1.0, 1.4 + ROBOT.lidar.x)]), abs=0.011)
        assert scene.path.tolist() == [[0.0, 0.0], [2.0, 0.0]]
        assert scene.sent == (0.1, 0.0)
        assert scene.goal is None
        assert (scene.notes["/lidar"].text, scene.notes["/lidar"].level) == ("<b>hot</b>", 1)
        floor = scene.map
        recording.advance(3.0)
        assert recording.time == pytest.approx(7.0)
        assert scene.pose == pytest.approx((1.0, 0.7, 0.5 * math.pi), abs=0.011)
        assert scene.goal == (2.0, 0.0)
        assert (scene.raw, scene.sent) == ((0.2, 0.0), (0.05, 0.0))
        assert scene.notes["safety filter"].text == "corrected: a wall"
        recording.seek(1.0)  # backwards
        assert scene.pose == pytest.approx((1.0, 0.1, 0.5 * math.pi), abs=0.011)
        assert (len(scene.path), scene.goal, scene.map) == (0, None, floor)
        recording.advance(60.0)
        assert recording.time == recording.duration


def test_what_is_wrong_with_a_message_is_shown_until_a_good_one_comes(tmp_path: Path) -> None:
    wrong = scan(1.0, 0)
    wrong.angle_max = 40.0
    messages = [(0, "odom", odometry(0.0, 0)), (0, "scan", wrong), (5 * S, "scan", scan(1.0, 5 * S))]
    with open_bag(write(tmp_path / "bag", messages)) as bag:
        recording = Recording(bag, ROBOT)
        assert "echoes would appear in wrong directions" in recording.scene.notes["scan"].text
        recording.advance(5.0)
        assert "scan" not in recording.scene.notes
        assert len(recording.scene.scan) == 1
        assert recording.scene.notes["pose"].text.startswith("that of the odometry: no transform from 'map' to")


def test_a_bag_of_something_else_is_refused(tmp_path: Path) -> None:
    folder = write(tmp_path / "bag", [(0, "/diagnostics", DiagnosticArray())])
    with open_bag(folder) as bag, pytest.raises(BagError, match="none of the topics that are shown"):
        Recording(bag, ROBOT)


def test_texts_are_few_and_short() -> None:
    scene = Scene()
    for number in range(1000):
        scene.say(f"node {number}", 1000 * "x")
    assert len(scene.notes) == MOST_NOTES
    assert max(len(note.text) for note in scene.notes.values()) == 300
    scene.say("node 0", "")
    assert "node 0" not in scene.notes


def test_wrong_tokens_are_few_whoever_gives_them() -> None:
    access = Access()
    assert len(access.token) >= 16
    assert access.token != Access().token
    assert access.check(access.token, 0.0) == ""
    assert access.check(f" {access.token}\n", 0.0) == ""
    for number in range(MOST_WRONG):
        assert access.check(f"guess {number}\udc80", number) == "this is not the token"
    assert access.check("another", 6.0) == "too many wrong tokens: wait 54 s"
    assert access.check(access.token, 6.0).startswith("too many")
    assert access.check(access.token, SPAN_S + 0.1) == ""
    with pytest.raises(TokenError, match="8 or more"):
        Access("1234567")


def test_walls_stand_where_the_boxes_are() -> None:
    vertices, faces = boxes_mesh([Box((1.0, 2.0), (0.5, 0.2)), Box((0.0, 0.0), (2.0, 0.1), 0.5 * math.pi)], 0.3)
    assert vertices[:8].min(axis=0) == pytest.approx((0.75, 1.9, 0.0))
    assert vertices[:8].max(axis=0) == pytest.approx((1.25, 2.1, 0.3))
    assert vertices[8:, 1].max() == pytest.approx(1.0)
    corners = vertices[faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middles = corners.mean(axis=1) - np.repeat(((1.0, 2.0, 0.15), (0.0, 0.0, 0.15)), len(faces) // 2, axis=0)
    assert (np.einsum("ij,ij->i", outward, middles) > 0.0).all()


def test_free_floor_is_clear_and_the_best_value_lies_deepest() -> None:
    cells = np.array([[0, 100, -1]], np.int8)
    assert floor_of(OccupancyMap(cells, 0.1))[0, :, 3].tolist() == [0, 255, 255]
    heights = np.array([[0.0, 0.5, 1.0], [0.2, 0.6, math.nan], [0.4, 0.7, math.nan]])
    found = funnel_of(Surface(heights, 0.5, (1.0, 0.0, 0.0)), 2.0)
    assert found is not None
    (vertices, faces), colours = found
    assert vertices[0].tolist() == [1.0, 0.0, -2.0]
    assert vertices[2].tolist() == [2.0, 0.0, 0.0]
    assert (len(vertices), len(faces), len(colours)) == (7, 4, 7)  # two squares without an unknown corner
    assert funnel_of(Surface(np.full((3, 3), math.nan), 0.5, (0.0, 0.0, 0.0)), 2.0) is None


def test_a_value_file_is_cut_at_the_heading_of_the_robot(tmp_path: Path) -> None:
    axes = (
        Axis("x", "m", 0.0, 1.0, 5),
        Axis("y", "m", 0.0, 2.0, 9),
        Axis("theta", "rad", -math.pi, math.pi, 8, periodic=True),
    )
    values = np.broadcast_to(np.cos(np.linspace(-math.pi, math.pi, 8, endpoint=False)), (5, 9, 8)) + 1.0
    values = values * np.linspace(1.0, 2.0, 5)[:, None, None]
    file = tmp_path / "value.safetensors"
    ValueGrid(values, axes, "time_to_reach", "own", "0" * 64, "test", 0.0).save(file)
    slices = ValueSlice(file)
    ahead = slices.at(0.0)
    assert slices.at(0.1) is ahead
    assert slices.at(0.5) is not ahead
    assert ahead.heights.shape == (150, 75)
    assert (ahead.heights[0, 0], np.nanmax(ahead.heights)) == pytest.approx((0.0, 1.0), abs=0.02)


@WITH_VISER
def test_a_visitor_without_the_token_moves_nothing() -> None:
    from ctrl_rl_bringup.view.page import Page

    page = Page("127.0.0.1", 0, ROBOT, Access("swordfish99"))
    try:
        page.draw(Scene(pose=(1.0, 2.0, 0.5)))
        send_as_intruder(page.address)
        assert page.take_requests() == []
    finally:
        page.close()


@WITH_VISER
@pytest.mark.parametrize(
    ("words", "arguments"),
    [
        ("there is no such bag", ("--bag", "nowhere")),
        ("a token of 5 letters: must have 8 or more", ("--token", "12345")),
        ("a bag has no robot to move", ("--bag", "nowhere", "--token", "12345678")),
        ("--port 70000: must be 0 to", ("--port", "70000")),
        ("no robot 'nobody'", ("--robot", "nobody")),
        ("there is no such file", ("--value", "none.safetensors")),
        ("no map 'nowhere'", ("--map", "nowhere")),
        ("--host 203.0.113.7: ", ("--bag", "{bag}", "--host", "203.0.113.7")),
    ],
)
def test_a_mistake_gets_one_line(words: str, arguments: tuple[str, ...], tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", [(0, "odom", odometry(0.0, 0))])
    check_refused(words, "view", *(each.format(bag=bag) for each in arguments))


def test_without_viser_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    from ctrl_rl_bringup.view import view_node

    find: Callable[[str], Any] = find_spec
    monkeypatch.setattr(view_node, "find_spec", lambda name: None if name == "viser" else find(name))
    with pytest.raises(view_node.CommandError, match=r"pip install -r requirements/view\.txt"):
        view_node.ViewOptions().check()

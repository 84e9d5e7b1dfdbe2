"""The policy node on topics: its commands, the reasons for a stop, and a policy change while driving."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rclpy
from ctrl_rl_core.ros.node import ODOM_PUBLISHER, SCAN_PUBLISHER, float32_array, to_stamp
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped, TwistStamped
from nav_msgs.msg import Odometry
from policy_files import FLY, actor, manifest, write
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from ctrl_rl_core import COMMAND, Actor, PolicyManifest, find_policy
from ctrl_rl_msgs.msg import RotorThrusts

STEP = 10**8
GOAL = [{"source": "goal", "names": ["ahead", "left"]}]


class Robot:
    """The other side of the topics: sends scans, and receives commands."""

    def __init__(self, kind: type, topic: str) -> None:
        self.node = rclpy.create_node("robot")
        self.odom = self.node.create_publisher(Odometry, "odom", ODOM_PUBLISHER)
        self.scan = self.node.create_publisher(LaserScan, "scan", SCAN_PUBLISHER)
        self.goal = self.node.create_publisher(PoseStamped, "goal_pose", 1)
        self.answers: dict[int, tuple[float, float]] = {}
        self.last = (0.0, 0.0)
        self._sent = 0
        self.node.create_subscription(kind, topic, self._hear, COMMAND)

    def _hear(self, message: TwistStamped | RotorThrusts) -> None:
        self.last = (
            (message.t1, message.t2)
            if isinstance(message, RotorThrusts)
            else (message.twist.linear.x, message.twist.angular.z)
        )
        self.answers[message.header.stamp.sec * 10**9 + message.header.stamp.nanosec] = self.last

    def wait(self, done: Callable[[], bool], seconds: float = 30.0) -> bool:
        deadline = time.monotonic() + seconds
        while not done():
            if time.monotonic() > deadline:
                return False
            rclpy.spin_once(self.node, timeout_sec=0.02)
        return True

    def ask(
        self,
        v: float = 0.0,
        odometry: bool = True,
        x: float = 0.0,
        y: float = 0.0,
        ahead: float = 3.0,
        upright: float = 1.0,
        direction: float = 1.0,
        stamped: bool = False,
    ) -> tuple[float, float]:
        """Return the command for one more scan, of a room of 3 m with a wall ahead at this distance."""
        self._sent += 1
        stamp = self._sent * STEP
        if odometry:
            message = Odometry(child_frame_id="base_link")
            message.header.frame_id = "odom"
            message.twist.twist.linear.x = v
            message.pose.pose.position.x, message.pose.pose.position.y = x, y
            message.pose.pose.orientation.w = upright
            if stamped:
                message.header.stamp = to_stamp(stamp)
            self.odom.publish(message)
            self.wait(lambda: False, 0.02)
        ranges = np.full(360, 3.0) + 1e-3 * np.random.default_rng(self._sent).random(360)
        ranges[np.arange(-30, 31)] *= ahead / 3.0
        scan = LaserScan(
            angle_max=2 * np.pi * 359 / 360,
            angle_increment=direction * 2 * np.pi / 360,
            range_min=0.12,
            range_max=10.0,
            ranges=float32_array(ranges),
        )
        scan.header.stamp = to_stamp(stamp)
        self.scan.publish(scan)
        assert self.wait(lambda: stamp in self.answers), "no answer"
        return self.answers[stamp]

    def begin(self) -> None:
        """Return once the node responds to scans."""
        topics = ("scan", "odom", "goal_pose")
        assert self.wait(lambda: all(self.node.count_subscribers(topic) for topic in topics))
        self.wait(lambda: False, 0.5)  # the last match is seen here before it is seen by both of its ends

    def set_policy(self, file: Path) -> str:
        """Set another policy and return the reason for a refusal, or "" if accepted."""
        client = self.node.create_client(SetParameters, "policy/set_parameters")
        assert client.wait_for_service(30.0)
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(file))
        future = client.call_async(SetParameters.Request(parameters=[Parameter(name="policy", value=value)]))
        assert self.wait(future.done)
        return future.result().results[0].reason


@pytest.fixture
def robot() -> Iterator[Callable[[type, str], Robot]]:
    rclpy.init()
    robots: list[Robot] = []

    def make(kind: type = TwistStamped, topic: str = "cmd_vel") -> Robot:
        robots.append(Robot(kind, topic))
        return robots[-1]

    yield make
    for each in robots:
        each.node.destroy_node()
    rclpy.try_shutdown()


def exploding(folder: Path) -> Path:
    """Return a policy whose network overflows to NaN as soon as the robot moves."""
    interface, file = manifest(), folder / "exploding.safetensors"
    first, second = np.zeros((2, interface.size), np.float32), np.zeros((2, 2), np.float32)
    first[:, 4] = 3e38
    second[:, 0], second[:, 1] = 3e38, -3e38
    made = actor(interface, activation="relu", weights=(first, second), biases=(np.zeros(2, np.float32),) * 2)
    made.save(file)
    return file


def test_it_drives_holds_swaps_and_stands(robot: Callable, run_node: Callable, tmp_path: Path) -> None:
    """One node runs through all cases, because starting one takes longer than a hundred scans."""
    slow, fast = write(tmp_path, "slow"), write(tmp_path, "fast", (1.0, 0.5), period=0.3)
    waits = write(tmp_path, "waits", observation=GOAL)
    node = run_node("ctrl_rl_core", "policy", f"policy:={slow}", "scan_timeout:=5.0")
    body = robot()
    body.begin()
    assert body.ask(odometry=False) == (0.0, 0.0), "without odometry"
    assert body.ask() == pytest.approx((0.1, 0.0))
    assert body.set_policy(fast) == ""
    assert body.ask() == pytest.approx((0.2, 0.5))
    node.wait_for("policy slow.safetensors (")
    node.wait_for("it decides every 0.3 s")

    flies = tmp_path / "flies.safetensors"
    actor(PolicyManifest.model_validate(FLY)).save(flies)
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(slow.read_bytes()[:200])
    for file, reason in (
        (flies, "flies.safetensors is for a planar_quadrotor, this node moves a differential_drive"),
        (broken, "broken.safetensors: is not a whole safetensors file"),
        (tmp_path / "none.safetensors", "none.safetensors: there is no such file"),
    ):
        assert reason in body.set_policy(file)
        assert body.ask() == pytest.approx((0.2, 0.5)), "the one before drives on"

    assert body.set_policy(waits) == ""
    assert body.ask() == (0.0, 0.0)
    node.wait_for("stopping: waiting for goal_pose")
    goal = PoseStamped()
    for frame, driven in (("map", (0.0, 0.0)), ("odom", (0.1, 0.0))):
        goal.header.frame_id = frame
        body.goal.publish(goal)
        node.wait_for(f"goal (0.00, 0.00) m in '{frame}'")
        assert body.ask() == pytest.approx(driven)
    goal.pose.position.x = float("nan")
    body.goal.publish(goal)
    node.wait_for("goal_pose refused: a translation of")

    assert body.set_policy(exploding(tmp_path)) == ""
    assert body.ask() == pytest.approx((0.1, 0.0))
    assert body.ask(v=0.1) == (0.0, 0.0)
    node.wait_for("stopping: the command is nan m/s, nan rad/s: not finite")
    assert body.ask() == pytest.approx((0.1, 0.0))
    code, _ = node.stop()
    assert code == 0
    assert body.wait(lambda: body.last == (0.0, 0.0)), "the last command is zero"
    assert "Traceback" not in node.output


def test_what_contradicts_itself_stops_the_robot(robot: Callable, run_node: Callable, tmp_path: Path) -> None:
    node = run_node("ctrl_rl_core", "policy", f"policy:={write(tmp_path, 'slow')}", "scan_timeout:=5.0")
    body = robot()
    body.begin()
    assert body.ask()[0] > 0.0
    assert body.ask(direction=-1.0) == (0.0, 0.0), "beams turn the other way than the angles say"
    node.wait_for("stopping: the scan has 360 ranges, and -358 by its angle_min, _max and _increment")
    assert body.ask()[0] > 0.0
    assert body.ask(upright=0.0) == (0.0, 0.0)
    node.wait_for("stopping: odometry with a quaternion of length 0: must be 1")
    moved = [body.ask(x=0.05 * step, stamped=True)[0] for step in range(12)]
    assert min(moved) > 0.0, "a base that never reports a twist"
    node.wait_for("odometry: its twist is always zero: speeds are those of the pose's motion")
    moved = [body.ask(x=0.6 + 0.05 * step, v=0.5 if step < 2 else 0.0, stamped=True)[0] for step in range(12)]
    assert moved[0] > 0.0
    assert moved[-1] == 0.0
    node.wait_for("in its pose, of which its speeds explain ")
    moved = [body.ask(x=1.2 + 0.05 * step, v=0.5, stamped=True)[0] for step in range(20)]
    assert moved[-1] > 0.0, "its twist explains its pose again"


def overflowing(name: str, folder: Path) -> Path:
    """Return a shipped policy whose network overflows to NaN at x = y = 4 m."""
    known, file = Actor.load(find_policy(name)), folder / f"{name}.safetensors"
    first = known.weights[0].copy()
    first[:, 0], first[:, 1] = 3e38, -3e38
    replace(known, weights=(first, *known.weights[1:])).save(file)
    return file


def test_guards_hold_with_policies_that_are_shipped(robot: Callable, run_node: Callable, tmp_path: Path) -> None:
    node = run_node("ctrl_rl_core", "policy", "policy:=car_ttr", "scan_timeout:=3.0")
    body = robot()
    body.begin()
    assert body.ask()[0] > 0.5
    assert body.ask(ahead=0.3)[0] == 0.0
    node.wait_for("obstacle")
    assert body.ask()[0] > 0.5, "the way is free again"
    assert body.set_policy(find_policy("car_navigation")) == ""
    assert body.ask(x=2.0, y=2.0)[0] > 0.5
    assert "quad_ttr.safetensors is for a planar_quadrotor" in body.set_policy(find_policy("quad_ttr"))
    assert body.ask(x=2.0, y=2.0)[0] > 0.5, "the one before drives on"
    assert body.set_policy(overflowing("car_navigation", tmp_path)) == ""
    assert body.ask(x=4.0, y=4.0) == (0.0, 0.0)
    node.wait_for("not finite")
    assert body.set_policy(find_policy("car_ttr")) == ""
    assert body.ask()[0] > 0.5
    assert body.wait(lambda: body.last == (0.0, 0.0)), "no scan comes any more"
    node.wait_for("stopping: no recent scan")


def test_the_pose_comes_from_transforms_where_that_is_asked_for(
    robot: Callable, run_node: Callable, tmp_path: Path
) -> None:
    file = write(tmp_path, observation=GOAL)
    node = run_node("ctrl_rl_core", "policy", f"policy:={file}", "pose:=tf", "goal_tolerance:=0.5", "scan_timeout:=5.0")
    body = robot()
    transforms = body.node.create_publisher(TFMessage, "/tf", 10)
    body.begin()
    goal = PoseStamped()
    goal.header.frame_id, goal.pose.position.x = "map", 2.0
    body.goal.publish(goal)
    node.wait_for("goal (2.00, 0.00) m in 'map'")
    assert body.ask() == (0.0, 0.0)
    node.wait_for("stopping: no transform from 'map' to 'base_link'")
    for x, driven in ((0.0, 0.1), (1.8, 0.0)):
        link = TransformStamped(child_frame_id="base_link")
        link.header.frame_id, link.transform.translation.x = "map", x
        transforms.publish(TFMessage(transforms=[link]))
        body.wait(lambda: False, 0.2)
        assert body.ask() == pytest.approx((driven, 0.0))


def test_the_pose_comes_from_a_localiser_and_the_odometry_since_where_that_is_asked_for(
    robot: Callable, run_node: Callable, tmp_path: Path
) -> None:
    file = write(tmp_path, observation=GOAL)
    words = (f"policy:={file}", "pose:=amcl_pose", "goal_tolerance:=0.5", "scan_timeout:=5.0")
    node = run_node("ctrl_rl_core", "policy", *words)
    body = robot()
    localiser = body.node.create_publisher(PoseWithCovarianceStamped, "amcl_pose", 10)
    body.begin()
    goal = PoseStamped()
    goal.header.frame_id, goal.pose.position.x = "map", 2.0
    body.goal.publish(goal)
    node.wait_for("goal (2.00, 0.00) m in 'map'")
    assert body.ask() == (0.0, 0.0)
    node.wait_for("stopping: no amcl_pose yet")
    for frame, x, driven in (("map", 0.0, 0.1), ("moon", 1.8, 0.1), ("map", 1.8, 0.0)):
        pose = PoseWithCovarianceStamped()
        pose.header.frame_id, pose.pose.pose.position.x = frame, x
        localiser.publish(pose)
        body.wait(lambda: False, 0.2)
        assert body.ask() == pytest.approx((driven, 0.0))


def test_a_command_holds_for_the_policy_s_period(robot: Callable, run_node: Callable, tmp_path: Path) -> None:
    """The policy's turn rate is the speed observed at the decision, every third scan."""
    interface, file = manifest(period=0.3), tmp_path / "policy.safetensors"
    first, second = np.zeros((1, interface.size), np.float32), np.ones((2, 1), np.float32)
    first[0, 4] = 1.0
    none = (np.zeros(1, np.float32), np.zeros(2, np.float32))
    actor(interface, activation="relu", weights=(first, second), biases=none).save(file)
    run_node("ctrl_rl_core", "policy", f"policy:={file}", "scan_timeout:=5.0")
    body = robot()
    body.begin()
    turns = [body.ask(v=0.01 * count)[1] for count in range(1, 8)]
    assert turns == pytest.approx([0.01, 0.01, 0.01, 0.04, 0.04, 0.04, 0.07], abs=1e-6)


def test_a_quadrotor_is_flown_on_its_rotors_and_hovers_when_blind(
    robot: Callable, run_node: Callable, tmp_path: Path
) -> None:
    file = tmp_path / "policy.safetensors"
    actor(PolicyManifest.model_validate(FLY), (0.5, 0.0)).save(file)
    node = run_node("ctrl_rl_core", "policy", f"policy:={file}", "scan_timeout:=1.0")
    body = robot(RotorThrusts, "rotor_thrusts")
    body.begin()
    assert body.ask() == pytest.approx((9.5, 8.0))
    assert body.wait(lambda: body.last == pytest.approx((6.13, 6.13))), "no scan comes any more"
    node.wait_for("stopping: no recent scan")
    assert body.node.count_publishers("cmd_vel") == 0

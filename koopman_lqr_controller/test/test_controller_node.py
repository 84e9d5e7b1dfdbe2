"""The controller as a process: commands for scans, a halt when in doubt, a clean end."""

import signal
import time
from array import array
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rclpy
from ctrl_rl_core.bags import read_messages
from ctrl_rl_core.ros import COMMAND, RESULT, SCAN_PUBLISHER, to_stamp
from geometry_msgs.msg import Twist, TwistStamped
from koopman_lqr_controller.edmd import LinearModel
from koopman_lqr_controller.encoder import Dense, Encoder
from koopman_lqr_controller.latent_controller import LatentController
from koopman_lqr_controller.latent_policy import LatentPolicy, LidarWiring
from koopman_lqr_controller.lidar_observation import LidarObservation
from koopman_lqr_controller.policy_file import save_policy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

from ctrl_rl_msgs.msg import LatentState

V_LIMIT, OMEGA_LIMIT = 0.22, 2.84


class Robot:
    """The other side of the controller: publishes scans and odometry, keeps the commands."""

    def __init__(self, stamped: bool = True) -> None:
        rclpy.init()
        self.node = Node("robot")
        self.scan = self.node.create_publisher(LaserScan, "scan", SCAN_PUBLISHER)
        self.odom = self.node.create_publisher(Odometry, "odom", 10)
        self.commands: list[TwistStamped | Twist] = []
        self.latents: list[LatentState] = []
        kind = TwistStamped if stamped else Twist
        self.node.create_subscription(kind, "cmd_vel", self.commands.append, COMMAND)
        self.node.create_subscription(LatentState, "koopman_lqr_controller/latent", self.latents.append, RESULT)

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()

    def spin(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not until():
            rclpy.spin_once(self.node, timeout_sec=0.02)
        return until()

    def wait_for_controller(self) -> None:
        def found() -> bool:
            listeners = (self.scan.get_subscription_count(), self.odom.get_subscription_count())
            return min(listeners) > 0 and self.node.count_publishers("cmd_vel") > 0

        assert self.spin(20.0, found)
        deadline = time.monotonic() + 20.0
        while not self.spin(0.2, lambda: len(self.commands) > 0):  # both ends have matched once a scan is answered
            assert time.monotonic() < deadline
            self.send(corridor(0.0), 1, odometry=False)
        self.spin(0.3)
        self.commands.clear()

    def send(self, ranges: np.ndarray, nanoseconds: int, odometry: bool = True) -> None:
        if odometry:
            self.odom.publish(Odometry())
        scan = LaserScan(angle_increment=2 * np.pi / len(ranges), range_min=0.12, range_max=3.5)
        scan.header.stamp = to_stamp(nanoseconds)
        scan.ranges = array("f", ranges.tolist())
        self.scan.publish(scan)

    def answer_to(self, nanoseconds: int) -> TwistStamped | None:
        stamp = to_stamp(nanoseconds)
        return next((command for command in self.commands if command.header.stamp == stamp), None)


@pytest.fixture
def robot() -> Iterator[Robot]:
    robot = Robot()
    yield robot
    robot.close()


def corridor(offset: float) -> np.ndarray:
    bearing = np.arange(360) * 2 * np.pi / 360
    side = np.where(np.sin(bearing) > 0, 0.35 - offset, 0.35 + offset)
    return np.minimum(side / np.maximum(np.abs(np.sin(bearing)), 1e-6), 3.5)


def answered(robot: Robot, nanoseconds: int) -> bool:
    return robot.answer_to(nanoseconds) is not None


def ask(robot: Robot, ranges: np.ndarray, nanoseconds: int) -> TwistStamped:
    robot.odom.publish(Odometry())
    robot.spin(0.1)  # odometry and scan are two topics: a scan may overtake
    robot.send(ranges, nanoseconds)
    assert robot.spin(2.0, partial(answered, robot, nanoseconds))
    answer = robot.answer_to(nanoseconds)
    assert answer is not None
    return answer


def test_it_steers_away_from_the_nearer_wall_and_says_why(robot: Robot, run_node: Callable) -> None:
    controller = run_node("koopman_lqr_controller", "controller")
    robot.wait_for_controller()
    left, right = ask(robot, corridor(0.12), 1_000), ask(robot, corridor(-0.12), 2_000)
    assert left.twist.angular.z < -0.05 < 0.05 < right.twist.angular.z
    assert left.twist.linear.x > 0.0
    assert robot.spin(2.0, lambda: len(robot.latents) >= 2)
    last = robot.latents[-1]
    assert len(last.z) == len(last.z_predicted)
    assert last.prediction_error == pytest.approx(np.linalg.norm(np.subtract(last.z, last.z_predicted)))
    assert controller.process.poll() is None


def test_it_halts_without_odometry_on_a_blind_scan_and_when_scans_stop(robot: Robot, run_node: Callable) -> None:
    run_node("koopman_lqr_controller", "controller", "scan_timeout:=0.2")
    robot.wait_for_controller()
    robot.send(corridor(0.1), 1_000, odometry=False)
    assert robot.spin(2.0, lambda: len(robot.commands) > 0)
    assert robot.commands[-1].twist.linear.x == 0.0
    assert ask(robot, corridor(0.1), 2_000).twist.linear.x > 0.0
    robot.send(np.full(360, np.nan), 3_000)
    assert robot.spin(2.0, lambda: robot.commands[-1].twist.linear.x == 0.0)
    assert ask(robot, corridor(0.1), 4_000).twist.linear.x > 0.0
    assert robot.spin(2.0, lambda: robot.commands[-1].twist.linear.x == 0.0), "stale input stops the robot"
    assert robot.commands[-1].twist.angular.z == 0.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_leaves_the_robot_standing(robot: Robot, run_node: Callable, number: int) -> None:
    controller = run_node("koopman_lqr_controller", "controller", "scan_timeout:=5.0")
    robot.wait_for_controller()
    assert ask(robot, corridor(0.1), 1_000).twist.linear.x > 0.0
    code, seconds = controller.stop(number)
    assert code == 0
    assert seconds < 1.0
    assert robot.spin(1.0, lambda: robot.commands[-1].twist.linear.x == 0.0)


def test_it_speaks_plain_twist_to_older_robots(run_node: Callable) -> None:
    robot = Robot(stamped=False)
    try:
        run_node("koopman_lqr_controller", "controller", "enable_stamped_cmd_vel:=false")
        robot.wait_for_controller()
        deadline = time.monotonic() + 5.0
        while not any(command.linear.x > 0.0 for command in robot.commands):
            robot.send(corridor(0.0), 1_000)
            robot.spin(0.1)
            assert time.monotonic() < deadline
    finally:
        robot.close()


@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        ("policy:=nowhere", "no policy 'nowhere'"),
        ("scan_timeout:=100.0", "parameter 'scan_timeout' is out of range"),
        ("scan_timeout:=soon", "parameter 'scan_timeout' is 'soon': must be a number"),
    ],
)
def test_a_bad_parameter_ends_it_with_one_clear_message(run_node: Callable, parameter: str, words: str) -> None:
    controller = run_node("koopman_lqr_controller", "controller", parameter)
    assert controller.process.wait(20.0) != 0
    assert words in controller.output
    assert "Traceback" not in controller.output


def a_policy(observations: int, wiring: LidarWiring | None) -> LatentPolicy:
    weight = np.random.default_rng(0).normal(size=(3, observations)).astype(np.float32)
    zeros = np.zeros(1, np.float32)
    encoder = Encoder((Dense(weight, np.zeros(3, np.float32), False),), (observations,), zeros, zeros + 1)
    model = LinearModel(0.9 * np.eye(3), np.ones((3, 2)))
    controller = LatentController(encoder, model, np.ones(3), np.ones(2), np.zeros(3))
    return LatentPolicy(controller, 0.1, wiring, {"task": "cheetah_run"})


def test_a_policy_of_another_robot_ends_it_with_one_clear_message(run_node: Callable, tmp_path: Path) -> None:
    save_policy(a_policy(17, None), tmp_path / "cheetah.safetensors")
    controller = run_node("koopman_lqr_controller", "controller", f"policy:={tmp_path / 'cheetah.safetensors'}")
    assert controller.process.wait(20.0) != 0
    assert "of the task cheetah_run: it cannot drive from a lidar" in controller.output
    assert "Traceback" not in controller.output


def test_a_prediction_is_held_against_the_scan_that_it_was_made_for(
    robot: Robot, run_node: Callable, tmp_path: Path
) -> None:
    """Neither across a halt, nor a scan that comes at another time than the model's step."""
    observation = LidarObservation(count=12)
    wiring = LidarWiring(observation, np.array([0.0, -1.5]), np.array([0.22, 1.5]))
    save_policy(a_policy(len(observation.names), wiring), tmp_path / "corridor.safetensors")
    policy = f"policy:={tmp_path / 'corridor.safetensors'}"
    run_node("koopman_lqr_controller", "controller", policy, "scan_timeout:=5.0")
    robot.wait_for_controller()
    second = 1_000_000_000
    for stamp in (second, int(1.1 * second), int(1.9 * second)):
        ask(robot, corridor(0.0), stamp)
    robot.send(np.full(360, np.nan), int(1.95 * second))
    ask(robot, corridor(0.0), int(2.05 * second))
    assert robot.spin(2.0, lambda: len(robot.latents) >= 4)
    assert [bool(np.isfinite(latent.prediction_error)) for latent in robot.latents] == [False, True, False, False]


def test_every_scan_of_a_real_drive_gets_a_finite_command_within_limits(
    robot: Robot, run_node: Callable, real_drive: Path
) -> None:
    """A TurtleBot 4's lidar: 720 beams, 15 to 30 % of them infinite."""
    run_node("koopman_lqr_controller", "controller", "scan_timeout:=5.0")
    robot.wait_for_controller()
    scans = 0
    for message in read_messages(real_drive, ["/scan", "/odom"]):
        data = message.data
        if message.topic == "/odom":
            odometry = Odometry()
            odometry.twist.twist.linear.x = data.twist.twist.linear.x
            odometry.twist.twist.angular.z = data.twist.twist.angular.z
            robot.odom.publish(odometry)
            robot.spin(0.003)
            continue
        scans += 1
        scan = LaserScan(
            angle_min=data.angle_min,
            angle_increment=data.angle_increment,
            range_min=data.range_min,
            range_max=data.range_max,
            ranges=array("f", data.ranges.tolist()),
        )
        scan.header.stamp = to_stamp(scans)
        robot.scan.publish(scan)
        assert robot.spin(2.0, partial(answered, robot, scans))
    assert scans == 357
    commands = np.array(
        [[c.twist.linear.x, c.twist.angular.z] for c in robot.commands if c.header.stamp.nanosec <= 357]
    )
    assert np.isfinite(commands).all()
    assert (np.abs(commands) <= (V_LIMIT + 1e-9, OMEGA_LIMIT + 1e-9)).all()
    assert np.ptp(commands[:, 1]) > 0.1, "it looks at what it sees"

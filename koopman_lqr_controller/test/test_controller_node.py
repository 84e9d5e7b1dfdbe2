"""The controller as a process: commands for scans, a stop in case of doubt, a clean shutdown."""

import signal
import time
from array import array
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_core.ros import to_stamp
from nav_msgs.msg import Odometry
from robot_side import PATIENCE_S, Robot, a_policy, answered, ask, corridor
from sensor_msgs.msg import LaserScan

from ctrl_rl_bags import read_messages
from koopman_lqr_controller import LidarObservation, RobotInterface, save_policy

V_LIMIT, OMEGA_LIMIT = 0.22, 2.84
SCAN_PERIOD_NS = 200_000_000


def test_it_steers_away_from_the_nearer_wall_and_says_why(robot: Robot, run_node: Callable) -> None:
    controller = run_node("koopman_lqr_controller", "controller")
    robot.wait_for_controller()
    first, second = 1_000, 1_000 + SCAN_PERIOD_NS
    left, right = ask(robot, corridor(0.12), first), ask(robot, corridor(-0.12), second)
    assert left.twist.angular.z < -0.05 < 0.05 < right.twist.angular.z
    assert left.twist.linear.x > 0.0
    last = robot.thought_of(second)
    assert list(last.command) == [right.twist.linear.x, right.twist.angular.z]
    assert len(last.z) == len(last.z_predicted)
    assert last.prediction_error == pytest.approx(np.linalg.norm(np.subtract(last.z, last.z_predicted)))
    assert controller.process.poll() is None


def test_it_halts_without_odometry_on_a_blind_scan_and_when_scans_stop(robot: Robot, run_node: Callable) -> None:
    run_node("koopman_lqr_controller", "controller", "scan_timeout:=0.2")
    robot.wait_for_controller()
    robot.send(corridor(0.1), 1_000, odometry=False)
    assert robot.spin(PATIENCE_S, lambda: len(robot.commands) > 0)
    assert robot.commands[-1].twist.linear.x == 0.0
    assert ask(robot, corridor(0.1), 2_000).twist.linear.x > 0.0
    robot.send(np.full(360, np.nan), 3_000)
    assert robot.spin(PATIENCE_S, lambda: robot.commands[-1].twist.linear.x == 0.0)
    assert ask(robot, corridor(0.1), 4_000).twist.linear.x > 0.0
    assert robot.spin(PATIENCE_S, lambda: robot.commands[-1].twist.linear.x == 0.0), "stale input stops the robot"
    assert robot.commands[-1].twist.angular.z == 0.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_leaves_the_robot_standing(robot: Robot, run_node: Callable, number: int) -> None:
    controller = run_node("koopman_lqr_controller", "controller", "scan_timeout:=5.0")
    robot.wait_for_controller()
    assert ask(robot, corridor(0.1), 1_000).twist.linear.x > 0.0
    code, _ = controller.stop(number)
    assert code == 0
    assert robot.spin(PATIENCE_S, lambda: robot.commands[-1].twist.linear.x == 0.0)


def test_it_speaks_plain_twist_to_older_robots(run_node: Callable) -> None:
    robot = Robot(stamped=False)
    try:
        run_node("koopman_lqr_controller", "controller", "enable_stamped_cmd_vel:=false")
        robot.wait_for_controller()
        deadline = time.monotonic() + PATIENCE_S
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
    assert controller.process.wait(120.0) != 0
    assert words in controller.output
    assert "Traceback" not in controller.output


def test_a_policy_of_another_robot_ends_it_with_one_clear_message(run_node: Callable, tmp_path: Path) -> None:
    save_policy(a_policy(17, None), tmp_path / "cheetah.safetensors")
    controller = run_node("koopman_lqr_controller", "controller", f"policy:={tmp_path / 'cheetah.safetensors'}")
    assert controller.process.wait(120.0) != 0
    assert "for the task cheetah_run, which has no lidar" in controller.output
    assert "Traceback" not in controller.output


def test_a_prediction_is_held_against_the_scan_that_it_was_made_for(
    robot: Robot, run_node: Callable, tmp_path: Path
) -> None:
    """Not across a stop, nor with a scan at another time than one model step later."""
    observation = LidarObservation(count=12)
    robot_interface = RobotInterface(observation, np.array([0.0, -1.5]), np.array([0.22, 1.5]))
    save_policy(a_policy(len(observation.names), robot_interface), tmp_path / "corridor.safetensors")
    policy = f"policy:={tmp_path / 'corridor.safetensors'}"
    run_node("koopman_lqr_controller", "controller", policy, "scan_timeout:=5.0")
    robot.wait_for_controller()
    second = 1_000_000_000
    for stamp in (second, int(1.1 * second), int(1.9 * second)):
        ask(robot, corridor(0.0), stamp)
    robot.send(np.full(360, np.nan), int(1.95 * second))
    ask(robot, corridor(0.0), int(2.05 * second))
    stamps = [int(at * second) for at in (1.0, 1.1, 1.9, 2.05)]
    errors = [robot.thought_of(stamp).prediction_error for stamp in stamps]
    assert [bool(np.isfinite(error)) for error in errors] == [False, True, False, False]


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
            angle_max=data.angle_max,
            angle_increment=data.angle_increment,
            range_min=data.range_min,
            range_max=data.range_max,
            ranges=array("f", data.ranges.tolist()),
        )
        scan.header.stamp = to_stamp(scans)
        robot.scan.publish(scan)
        assert robot.spin(PATIENCE_S, partial(answered, robot, scans))
    assert scans == 357
    commands = np.array(
        [[c.twist.linear.x, c.twist.angular.z] for c in robot.commands if c.header.stamp.nanosec <= 357]
    )
    assert np.isfinite(commands).all()
    assert (np.abs(commands) <= (V_LIMIT + 1e-9, OMEGA_LIMIT + 1e-9)).all()
    assert np.ptp(commands[:, 1]) > 0.1, "it looks at what it sees"

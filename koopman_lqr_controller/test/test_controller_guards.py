"""The controller as a process in situations where it must not drive: guards, policy changes, dry runs."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from robot_side import PATIENCE_S, Robot, a_policy, ask, corridor
from safetensors.numpy import save_file

from ctrl_rl_core import ScanGeometry
from koopman_lqr_controller import (
    DEFAULT_POLICY,
    LatentDistribution,
    LatentPolicy,
    LidarObservation,
    RobotInterface,
    find_policy,
    load_policy,
    save_policy,
)

OBSERVATION = LidarObservation(count=12)
ROBOT = RobotInterface(OBSERVATION, np.array([0.0, -1.5]), np.array([0.22, 1.5]))
SECOND = 1_000_000_000
ANYWHERE = LatentDistribution(np.zeros(3), np.eye(3), 1e3, 1e3)


def learnt(path: Path, distribution: LatentDistribution | None) -> LatentPolicy:
    policy = replace(a_policy(len(OBSERVATION.names), ROBOT), distribution=distribution)
    save_policy(policy, path)
    return policy


def set_parameter(robot: Robot, name: str, value: object) -> tuple[bool, str]:
    """Set a parameter as `ros2 param set` does; return whether it was accepted, and the reason if not."""
    client = robot.node.create_client(SetParameters, "koopman_lqr_controller/set_parameters")
    assert robot.spin(PATIENCE_S, client.service_is_ready)
    future = client.call_async(SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()]))
    assert robot.spin(PATIENCE_S, future.done)
    robot.node.destroy_client(client)
    (result,) = future.result().results
    return result.successful, result.reason


def set_parameters_atomically(robot: Robot, **values: object) -> bool:
    """Return whether all parameters were accepted."""
    client = robot.node.create_client(SetParametersAtomically, "koopman_lqr_controller/set_parameters_atomically")
    assert robot.spin(PATIENCE_S, client.service_is_ready)
    wanted = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    future = client.call_async(SetParametersAtomically.Request(parameters=wanted))
    assert robot.spin(PATIENCE_S, future.done)
    robot.node.destroy_client(client)
    return bool(future.result().result.successful)


def seen(ranges: np.ndarray) -> tuple[np.ndarray, ScanGeometry]:
    """Return a LaserScan's version of the robot's ranges and their geometry."""
    increment, least = np.float32([2 * np.pi / len(ranges), 0.12]).tolist()
    return ranges.astype(np.float32), ScanGeometry(len(ranges), 0.0, increment, least, 3.5)


def diagnosed(robot: Robot, words: str, seconds: float = 10.0) -> DiagnosticStatus:
    """Return the controller's first diagnostics that contain a text, in the message or in a value."""
    heard: list[DiagnosticStatus] = []
    listen = robot.node.create_subscription(
        DiagnosticArray, "diagnostics", lambda message: heard.extend(message.status), 10
    )

    def found() -> list[DiagnosticStatus]:
        return [status for status in heard if words in " ".join([status.message, *(v.value for v in status.values)])]

    assert robot.spin(seconds, lambda: bool(found())), heard
    robot.node.destroy_subscription(listen)
    return found()[0]


@pytest.mark.parametrize("kind", ["edmd", "learnt"])
def test_outside_what_training_saw_it_stops_says_so_and_recovers(
    robot: Robot, run_node: Callable, tmp_path: Path, kind: str
) -> None:
    """The same mechanism for both kinds of policy: the corridor's centre is inside, a place by the wall is outside."""
    file = tmp_path / "policy.safetensors"
    policy = load_policy(find_policy("curved_corridor_edmd")) if kind == "edmd" else learnt(file, None)
    decisions = [policy.decide(*seen(corridor(offset)), 0.0, 0.0).z for offset in (0.0, 0.2)]
    middle = LatentDistribution(decisions[0], np.eye(len(decisions[0])), 0.3 * math.dist(*decisions), 1e3)
    save_policy(replace(policy, distribution=middle), file, overwrite=True)
    run_node("koopman_lqr_controller", "controller", f"policy:={file}", "scan_timeout:=5.0")
    robot.wait_for_controller()
    moves = []
    for index, offset in enumerate((0.0, 0.2, 0.2, 0.0)):
        stamp = (index + 1) * SECOND // 10
        answer = ask(robot, corridor(offset), stamp).twist
        thought = robot.thought_of(stamp)
        moves.append((answer.linear.x, answer.angular.z) != (0.0, 0.0))
        assert moves[-1] == (thought.stop == "")
        assert (thought.distance > 2.0) == (offset > 0.0)
        if offset:
            assert "left the region seen in training" in thought.stop
            assert list(thought.command) == [0.0, 0.0]
            assert len(thought.control) == 2, "what it would have done is still said"
        if index == 1:
            status = diagnosed(robot, "left the region seen in training")
            assert status.level == DiagnosticStatus.WARN
    assert moves == [True, False, False, True]
    assert set_parameter(robot, "largest_distance", 0.0)[0]
    assert ask(robot, corridor(0.2), SECOND).twist.angular.z != 0.0, "turned off"


def test_a_prediction_error_that_stays_high_stops_it_until_the_world_is_as_predicted(
    robot: Robot, run_node: Callable, tmp_path: Path
) -> None:
    """The scans jump at every step, then remain constant as the model predicts."""
    file = tmp_path / "policy.safetensors"
    policy = learnt(file, None)
    still = replace(
        policy.controller, model=replace(policy.controller.model, A=0.999 * np.eye(3), B=1e-3 * np.ones((3, 2)))
    )
    save_policy(replace(policy, controller=still, distribution=replace(ANYWHERE, error=0.2)), file, overwrite=True)
    run_node("koopman_lqr_controller", "controller", f"policy:={file}", "error_patience:=0.35", "scan_timeout:=5.0")
    robot.wait_for_controller()
    offsets = [0.0, 0.2] * 4 + [0.1] * 9
    stops = []
    for index, offset in enumerate(offsets):
        stamp = (index + 1) * SECOND // 10
        ask(robot, corridor(offset), stamp)
        stops.append(robot.thought_of(stamp).stop)
    assert stops[:5] == [""] * 5
    assert all("prediction error stays high" in stop for stop in stops[5:12])
    assert stops[-1] == ""
    assert set_parameter(robot, "largest_error", 0.0)[0]
    for index in range(6):
        stamp = (len(offsets) + index + 1) * SECOND // 10
        ask(robot, corridor(0.2 * (index % 2)), stamp)
        assert robot.thought_of(stamp).stop == "", "turned off"


def test_a_lidar_of_another_pace_ends_the_alarm_of_the_prediction_and_is_said(
    robot: Robot, run_node: Callable, tmp_path: Path
) -> None:
    file = tmp_path / "policy.safetensors"
    learnt(file, replace(ANYWHERE, error=1e-3))
    settings = ("error_patience:=0.0", "scan_timeout:=5.0", "most_retries:=0")
    run_node("koopman_lqr_controller", "controller", f"policy:={file}", *settings)
    robot.wait_for_controller()
    assert "watched" in {each.value for each in diagnosed(robot, "watched").values}
    stamps = [1, 2, *range(4, 44, 2)]
    stops = []
    for index, tenth in enumerate(stamps):
        ask(robot, corridor(0.1 * (index % 2)), tenth * SECOND // 10)
        stops.append(robot.thought_of(tenth * SECOND // 10).stop)
    assert stops[0] == ""
    assert all("prediction error stays high" in stop for stop in stops[1:21])
    assert stops[21:] == [""], "20 scans in a row that were not predicted: there is nothing to watch"
    diagnosed(robot, "not watched: scans come every 0.20 s, the model's step is 0.10 s")
    assert set_parameter(robot, "largest_error", 0.0)[0]
    diagnosed(robot, "not watched: largest_error is 0.0")


def test_stale_scans_are_said_in_latent_and_diagnostics(robot: Robot, run_node: Callable) -> None:
    run_node("koopman_lqr_controller", "controller", "scan_timeout:=0.3")
    robot.wait_for_controller()
    ask(robot, corridor(0.1), SECOND)
    assert robot.spin(PATIENCE_S, lambda: any(latent.stop == "no recent scan" for latent in robot.latents))
    last = next(latent for latent in robot.latents if latent.stop == "no recent scan")
    assert len(last.z) == len(robot.thought_of(SECOND).z)
    assert np.isnan(last.z).all()
    assert list(last.command) == [0.0, 0.0]
    assert diagnosed(robot, "no recent scan").level == DiagnosticStatus.WARN


def test_another_policy_drives_from_the_next_scan_on_and_a_bad_one_is_refused(
    robot: Robot, run_node: Callable, tmp_path: Path
) -> None:
    """With scans arriving as fast as they are answered, each is answered entirely by one of the two policies."""
    file = tmp_path / "other.safetensors"
    other = learnt(file, ANYWHERE)
    save_policy(a_policy(17, None), tmp_path / "cheetah.safetensors")
    (tmp_path / "broken.safetensors").write_bytes(file.read_bytes()[:-20])
    save_file({}, tmp_path / "headless.safetensors", {"policy": "[]"})
    run_node("koopman_lqr_controller", "controller", "scan_timeout:=5.0")
    robot.wait_for_controller()
    ask(robot, corridor(0.1), 1)  # it has heard odometry
    robot.thought_of(1)
    robot.latents.clear()
    sent: list[int] = []

    def send() -> None:
        if len(sent) - len(robot.latents) < 3:  # no more than a subscriber keeps
            sent.append((len(sent) + 1) * SECOND // 20)
            robot.send(corridor(0.1), sent[-1])

    timer = robot.node.create_timer(0.002, send)
    assert robot.spin(PATIENCE_S, lambda: len(robot.latents) >= 20)
    for name, words in (
        ("nowhere", "no policy 'nowhere'"),
        (str(tmp_path / "broken.safetensors"), "is not a whole safetensors file"),
        (str(tmp_path / "headless.safetensors"), "has a header that is no JSON object"),
        (str(tmp_path / "cheetah.safetensors"), "which has no lidar"),
    ):
        taken, reason = set_parameter(robot, "policy", name)
        assert not taken
        assert words in reason
    refused = len(robot.latents)
    assert robot.spin(PATIENCE_S, lambda: len(robot.latents) >= refused + 20)
    assert set_parameter(robot, "policy", str(file)) == (True, "")
    swapped = len(robot.latents)
    assert robot.spin(PATIENCE_S, lambda: len(robot.latents) >= swapped + 20)
    timer.cancel()
    thoughts = [robot.thought_of(stamp) for stamp in sent]
    sizes = [len(thought.z) for thought in thoughts]
    assert sizes == sorted(sizes, reverse=True), "none is between the two"
    assert sizes.index(3) >= refused + 20, "while others were refused the one before went on"
    assert {thought.stop for thought in thoughts} == {""}
    command = other.decide(*seen(corridor(0.1)), 0.0, 0.0).command
    assert list(thoughts[-1].command) == pytest.approx(command.tolist())
    status = diagnosed(robot, "driving")
    assert {value.key: value.value for value in status.values}["policy"] == "other.safetensors"


def test_a_dry_run_thinks_and_sends_nothing(robot: Robot, run_node: Callable) -> None:
    controller = run_node("koopman_lqr_controller", "controller", "dry_run:=true", "scan_timeout:=0.5")
    controller.wait_for(f"policy {DEFAULT_POLICY}")
    deadline, stamp = time.monotonic() + 120.0, 0
    while not any(latent.command[:1] and latent.command[0] > 0.0 for latent in robot.latents):
        stamp += 1
        robot.send(corridor(0.1), stamp)
        robot.spin(0.1)
        assert time.monotonic() < deadline
    assert all(latent.dry_run for latent in robot.latents)
    assert diagnosed(robot, "dry run, nothing is sent").message
    assert robot.spin(PATIENCE_S, lambda: robot.latents[-1].stop == "no recent scan")
    assert not set_parameters_atomically(robot, dry_run=False, policy="nowhere")
    robot.send(corridor(0.1), SECOND // 2)
    assert robot.thought_of(SECOND // 2).dry_run, "what is refused as a whole changes nothing"
    assert set_parameter(robot, "dry_run", True)[0]
    assert robot.commands == [], "somebody else may drive"
    assert set_parameter(robot, "dry_run", False)[0]
    assert ask(robot, corridor(0.1), SECOND).twist.linear.x > 0.0
    assert not robot.thought_of(SECOND).dry_run
    assert set_parameter(robot, "dry_run", True)[0]
    assert robot.spin(PATIENCE_S, lambda: robot.commands[-1].twist.linear.x == 0.0), "it stands when a dry run begins"
    controller.stop()
    before = len(robot.commands)
    assert not robot.spin(1.0, lambda: len(robot.commands) > before)

"""The pre-flight on simulated robots: it finds planted faults and passes a healthy one, as real processes."""

import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import rclpy
from ament_index_python.packages import get_package_prefix
from commands import command, start
from nav_msgs.msg import Odometry
from rclpy.node import Node

from ctrl_rl_core import SENSOR

sys.path.insert(0, str(Path(__file__).parent / "preflight"))

from planted import FAULTS, HEALTHY, look_at

QUICK = ("Twist instead of TwistStamped", "covered lidar")
PATIENT = ("--largest-gap", "5", "--largest-age", "5", "--largest-lead", "5", "--largest-delay", "5")
PATIENT += ("--scan-rate", "0.5", "--odom-rate", "1")
"""Options for a machine that is busy with other tests; they are too wide for a robot."""


def faults() -> list[object]:
    """Return the names of the faults; most take half a minute."""
    return [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in FAULTS]


def domain() -> int:
    return int(os.environ["ROS_DOMAIN_ID"])


@pytest.mark.fault
@pytest.mark.parametrize("name", faults())
def test_a_planted_fault_is_found(name: str, tmp_path: Path) -> None:
    quick = ("--seconds", "2") if name in QUICK else ()
    answer = look_at(name, tmp_path, domain(), options=quick)
    assert answer.finds(FAULTS[name]), answer.output


def test_a_healthy_robot_passes_and_its_report_says_so(tmp_path: Path) -> None:
    answer = look_at("healthy", tmp_path, domain(), options=("--seconds", "2", "--wait", "60", *PATIENT))
    assert answer.finds(HEALTHY), answer.output
    assert "GO: " in (tmp_path / "healthy" / "preflight.txt").read_text()
    checked = {finding["check"] for finding in answer.findings if finding["level"] == "ok"}
    assert {"map and pose", "battery", "turn by scan", "way by scan", "stands without commands"} <= checked


def test_without_a_robot_it_says_what_to_do(tmp_path: Path) -> None:
    answer = command("preflight", "--wait", "0.5", "--seconds", "1", "--output", tmp_path / "run")
    assert answer.returncode == 1
    assert "nobody publishes /scan" in answer.stdout
    assert "start the robot's bringup" in answer.stdout
    assert "NO-GO: " in (tmp_path / "run" / "preflight.txt").read_text()


def test_nobody_moves_the_robot_without_a_yes(tmp_path: Path) -> None:
    executable = Path(get_package_prefix("ctrl_rl_bringup")) / "lib" / "ctrl_rl_bringup" / "preflight"
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [executable, "--move", "floor", "--wait", "0", "--seconds", "1", "--output", tmp_path],
        stdin=slave,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.write(master, b"no\n")
    out, errors = process.communicate(timeout=60)
    os.close(master)
    os.close(slave)
    assert "Is a metre around it free? [yes/no]" in errors
    assert "not agreed to" in out


@pytest.mark.fault
def test_interrupted_while_the_robot_turns_it_leaves_it_standing(run_node: Callable, tmp_path: Path) -> None:
    rclpy.init()
    node, rates = Node("onlooker"), list[float]()
    node.create_subscription(Odometry, "odom", lambda said: rates.append(said.twist.twist.angular.z), SENSOR)

    def until(condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 120.0
        while not condition():
            assert time.monotonic() < deadline, f"{what}: {rates[-5:]}"
            rclpy.spin_once(node, timeout_sec=0.02)

    try:
        run_node("sim_bridge", "bridge", "cmd_vel_timeout:=0.0")
        moving = ("--move", "floor", "--yes", "--seconds", "1", "--wait", "60")
        process = start("preflight", *moving, *PATIENT, "--output", tmp_path / "run")
        until(lambda: process.poll() is not None or (bool(rates) and rates[-1] > 0.3), "it never turned")
        assert process.poll() is None, process.communicate()
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130, process.communicate()
        until(lambda: max(abs(rate) for rate in rates[-10:]) < 1e-3, "it turns on")
        _, errors = process.communicate()
        assert "preflight: interrupted" in errors
        assert "Traceback" not in errors
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("words", "arguments"),
    [
        ("--seconds 0: must be 1 to 600 s", ("--seconds", "0")),
        ("--scan-rate -1: must not be negative", ("--scan-rate", "-1")),
        ("add --yes", ("--move", "floor")),
        ("is a file: name a folder", ("--output", __file__)),
        ("wrong ROS arguments", ("--commands", "no topic")),
        ("unknown ROS argument", ("--ros-args", "--nonsense")),
    ],
)
def test_a_wrong_command_line_is_one_line_and_code_2(words: str, arguments: tuple[str, ...]) -> None:
    answer = command("preflight", *arguments)
    assert answer.returncode == 2, answer.stdout
    (line,) = answer.stderr.splitlines()[-1:]
    assert words in line
    assert "Traceback" not in answer.stderr

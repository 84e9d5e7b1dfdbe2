"""Several nodes in one process drive as they do in processes of their own, and end with one another where they must."""

import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from ctrl_rl_bringup.cli.stack import MEMBERS, chosen
from nav_msgs.msg import Odometry
from rclpy.node import Node

from ctrl_rl_bags import bag_info
from ctrl_rl_core import SENSOR, ParameterError

pytestmark = pytest.mark.fault
NODES = ("controller", "safety_filter", "recorder")
CLOCK = "use_sim_time:=true"


class Onlooker(Node):
    """Sees how fast the robot is, and who publishes what."""

    def __init__(self) -> None:
        super().__init__("onlooker")
        self.speeds = list[float]()
        self.create_subscription(
            Odometry, "ground_truth", lambda said: self.speeds.append(said.twist.twist.linear.x), SENSOR
        )

    def until(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 120.0
        while not condition():
            assert time.monotonic() < deadline, f"{what}: {self.speeds[-5:]}"
            rclpy.spin_once(self, timeout_sec=0.02)

    def drives(self) -> bool:
        return bool(self.speeds) and self.speeds[-1] > 0.05

    def publishers(self, topic: str) -> set[str]:
        return {each.node_name for each in self.get_publishers_info_by_topic(topic)}


@pytest.fixture
def onlooker() -> Iterator[Onlooker]:
    rclpy.init()
    node = Onlooker()
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def world(run_node: Callable) -> None:
    """Run a robot in a corridor, and the watchdog behind the filter."""
    run_node("sim_bridge", "bridge", "seed:=5")
    run_node("ctrl_rl_core", "watchdog", CLOCK, remap=("cmd_vel_raw:=cmd_vel_safe",))


@pytest.mark.usefixtures("world")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_drives_records_and_stops(run_node: Callable, onlooker: Onlooker, tmp_path: Path, number: int) -> None:
    bag = tmp_path / "bag"
    # The user's rule must not lead the controller past the filter.
    rules = ("cmd_vel:=cmd_vel_safe",)
    stack = run_node("ctrl_rl_bringup", "stack", CLOCK, f"output:={bag}", words=NODES, remap=rules)
    onlooker.until(onlooker.drives, "it never drove")
    for topic, name in (("/cmd_vel_raw", "controller"), ("/cmd_vel_safe", "safety_filter")):
        only = {MEMBERS[name].node}  # discovery tells of a publisher before it tells of its node's name
        onlooker.until(
            lambda topic=topic, only=only: onlooker.publishers(topic) == only, f"{topic} has others than {only}"
        )
    onlooker.until(
        lambda: {MEMBERS[each].node for each in NODES} <= set(onlooker.get_node_names()), "a node is missing"
    )
    assert stack.stop(number)[0] == 0
    onlooker.until(lambda: max(abs(speed) for speed in onlooker.speeds[-10:]) < 1e-3, "it drives on")
    assert {"/cmd_vel_raw", "/cmd_vel_safe", "/scan", "/odom"} <= set(bag_info(bag).topics)
    assert "Traceback" not in stack.output


@pytest.mark.usefixtures("world")
def test_a_recorder_that_fails_ends_alone(run_node: Callable, onlooker: Onlooker, tmp_path: Path) -> None:
    least = shutil.disk_usage(tmp_path).free // 1_000_000 - 300
    parameters = (CLOCK, f"output:={tmp_path}/bag", f"min_free_mb:={least}")
    stack = run_node("ctrl_rl_bringup", "stack", *parameters, words=NODES)
    onlooker.until(onlooker.drives, "it never drove")
    with (tmp_path / "large").open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, 600_000_000)
    stack.wait_for("ends, and the other nodes go on")
    onlooker.speeds.clear()
    onlooker.until(onlooker.drives, "it does not drive on")
    assert stack.stop()[0] == 1
    onlooker.until(lambda: max(abs(speed) for speed in onlooker.speeds[-10:]) < 1e-3, "it drives on")
    assert bag_info(tmp_path / "bag").topics
    assert "Traceback" not in stack.output


def test_a_wrong_parameter_of_one_node_ends_all_before_they_drive(run_node: Callable) -> None:
    stack = run_node("ctrl_rl_bringup", "stack", "control_period:=-1.0", words=NODES[:2])
    assert stack.process.wait(120.0) == 2
    assert "control_period" in stack.output
    assert "Traceback" not in stack.output


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("driver",), "no node 'driver'"),
        (("recorder", "recorder"), "named twice"),
        (("policy", "navigator"), "policy and navigator would both drive"),
    ],
)
def test_what_is_no_stack_is_refused(names: tuple[str, ...], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        chosen(names)

"""The environment on real nodes: a bridge, the safety filter, an operator, and what is said when one fails."""

import json
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from commands import command, start
from ctrl_rl_core.ros import initialise, to_stamp
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.values import solvable
from ctrl_rl_learning.on_robot.environment.rewards import StepReward
from ctrl_rl_learning.on_robot.environment.robot_env import RobotEnv
from ctrl_rl_learning.on_robot.learning.policy import read_policy
from ctrl_rl_learning.on_robot.nodes.robot_node import NAME, RAW, LearningNode
from ctrl_rl_learning.on_robot.nodes.ros_robot import OperatorStarts, Ros, RosRobot, SimulatorStarts
from ctrl_rl_learning.on_robot.nodes.stepped_robot import SteppedRobot
from ctrl_rl_safety.trials import CAR
from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import LaserScan
from std_srvs.srv import SetBool, Trigger

from ctrl_rl_core import COMMAND, Actor, ScanGeometry, load_navigation_task, load_policy, task_digest, task_file
from ttr_reward_node import TimeToReach, load_value, problem_from_task, solve

ARGUMENTS = ["--ros-args", "-r", f"{NAME}:cmd_vel:={RAW}"]
OPEN = ("-p", "lidar_x:=0.0", "-p", "min_echo_share:=0.0", "-p", "largest_gap:=6.3")
pytestmark = pytest.mark.usefixtures("_no_shared_memory")  # some are killed or frozen


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a task of short episodes with a lidar all around, its time to reach on few cells, and a car's constants."""
    folder = tmp_path_factory.mktemp("robot")
    content = yaml.safe_load(task_file("car_navigation").read_text())
    content["lidar"] |= {"beams": 180, "field": "-180.0 .. 180.0 deg", "placement": "edges"}
    content["episode"]["steps"] = 25
    (folder / "car_navigation.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    task = load_navigation_task(str(folder / "car_navigation.yaml"))
    problem = problem_from_task(solvable(task), counts=(31, 31, 18), inflation=task.robot.radius)
    solve(problem).grid.save(folder / f"car_navigation-{task_digest(task)[:12]}.safetensors")
    CAR.save(folder / "car.yaml")
    return folder


@pytest.fixture(scope="module")
def bridge(folder: Path, run_shared_node: Callable[..., Any]) -> Any:
    return run_shared_node(
        "sim_bridge", "bridge", f"task:={folder}/car_navigation.yaml", "engine:=planar", "physics_rate:=60"
    )


@pytest.fixture(scope="module")
def safety(folder: Path, run_shared_node: Callable[..., Any]) -> Any:
    return run_shared_node(
        "ctrl_rl_safety",
        "safety_filter",
        f"robot:={folder}/car.yaml",
        "use_sim_time:=true",
        "control_period:=0.11",
        *(word for word in OPEN if word != "-p"),
    )


class Stand:
    """An environment, its node, and the operator's topic."""

    def __init__(self, folder: Path, kind: type[RosRobot], simulated: bool = True) -> None:
        initialise(["test", *ARGUMENTS, *OPEN, "-p", f"use_sim_time:={str(simulated).lower()}"])
        self.task = load_navigation_task(str(folder / "car_navigation.yaml"))
        _, self.interface = read_policy("car_navigation", motion=True)
        self.ros = Ros(LearningNode(self.interface), 60.0)
        self.operator = self.ros.node.create_publisher(TwistStamped, "cmd_vel_operator", COMMAND)
        (value,) = folder.glob("*.safetensors")
        self.robot = kind(self.ros, SimulatorStarts(self.ros))
        self.reward = StepReward(self.task, TimeToReach(load_value(value)))
        self.environment = RobotEnv(self.robot, self.task, self.interface, self.reward)


@pytest.fixture
def stand(folder: Path) -> Iterator[Callable[..., Stand]]:
    stands: list[Stand] = []

    def make(kind: type[RosRobot], simulated: bool = True) -> Stand:
        stands.append(Stand(folder, kind, simulated))
        return stands[-1]

    yield make
    for each in stands:
        each.ros.close()
        rclpy.try_shutdown()


@pytest.mark.fault
def test_a_scan_from_the_future_blinds_nobody_and_what_is_kept_must_be_fresh() -> None:
    initialise(["test", *ARGUMENTS, *OPEN])
    _, interface = read_policy("car_navigation", motion=True)
    node = LearningNode(interface)
    try:

        def scan(ahead: float) -> float:
            """Take a scan so far ahead of the clock [s], and return how far what is kept is ahead of it."""
            now = node.get_clock().now().nanoseconds
            message = LaserScan(angle_increment=2.0 * np.pi / 180, range_min=0.1, range_max=5.0, ranges=[1.0] * 180)
            message.header.stamp = to_stamp(now + round(ahead * 1e9))
            node.robot.hear_scan(message)
            return node.stamp - 1e-9 * now

        assert scan(0.0) == pytest.approx(0.0, abs=0.01)
        assert scan(3600.0) == pytest.approx(0.0, abs=0.01)
        assert scan(0.01) == pytest.approx(0.01, abs=0.01), "the next one counts"
        deadline = time.monotonic() + 10.0
        while "no recent scan to drive by: a scan of 3600.0 s ahead" not in node._stale_scan():
            assert time.monotonic() < deadline
            scan(3600.0)
            time.sleep(0.05)
        scan(0.0)
        assert node._stale_scan() == ""
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


@pytest.mark.usefixtures("bridge", "safety")
def test_stepped_steps_are_whole_the_operator_goes_first_and_episodes_end(stand: Callable[..., Stand]) -> None:
    """One bridge goes through all of it: to start one takes longer than to drive."""
    it = stand(SteppedRobot)
    seen, _ = it.environment.reset(seed=3)
    assert it.environment.observation_space.contains(seen)
    forward = np.array((0.2, 0.0), np.float32)
    for _ in range(3):
        following, reward, terminated, truncated, info = it.environment.step(forward)
        assert not terminated
        assert not truncated
        assert info["duration"] == pytest.approx(0.4)
        assert (info["missed"], info["late_scans"], info["operator"]) == (0, 0, 0.0)
        assert info["late"] == pytest.approx(0.0, abs=1e-6)
        assert info["age"] < 0.11
        assert info["action"] == pytest.approx(forward, abs=1e-5)
    moved = float(np.linalg.norm(following[:2] - seen[:2]))
    assert 0.3 < moved < 1.2
    assert following[-2:] == pytest.approx((0.88, 0.0), abs=1e-5), "the last command is observed"
    assert np.isfinite(reward)

    message = TwistStamped()
    message.twist.linear.x, message.twist.angular.z = -0.4, 0.25
    it.operator.publish(message)
    it.ros.until(lambda: it.ros.node.operator.command(it.ros.node.robot.now()) is not None, "no operator")
    *_, info = it.environment.step(forward)
    assert info["operator"] == pytest.approx(1.0)
    assert info["action"] == pytest.approx(((-0.4 + 0.8) / 1.4 - 1.0, 0.5), abs=1e-5)
    it.environment.step(forward)
    *_, info = it.environment.step(forward)
    assert info["operator"] == 0.0, "it is given back when nobody drives it any more"

    node, now = it.ros.node, it.robot.now()
    time.sleep(node.settings["wall_timeout"] + 0.1)  # held up: all inputs are too old, and the clock stands
    assert "no recent" in node.robot.input_fault()
    assert it.robot.read().sensors.age < 0.11
    assert it.robot.now() == pytest.approx(now + 0.1)
    now = it.robot.now()
    kept = node.reading(now).sensors
    node.begin_step(now)
    node.robot.on_scan(LaserScan(), np.ones(3, np.float32), ScanGeometry(3, 0.0, 0.1, 0.1, 8.0))
    reading = node.reading(now)
    assert reading.late_scans == 1, "a scan out of order is counted"
    assert reading.sensors.ranges is kept.ranges, "and left out"

    changed = 0.0
    for _ in range(10):  # towards a wall or a box, before which the filter holds it
        *_, terminated, _, info = it.environment.step(np.array((1.0, 0.0), np.float32))
        changed = max(changed, info["changed"])
        assert not terminated
    assert changed == 1.0


@pytest.mark.usefixtures("bridge", "safety")
def test_it_drives_in_the_time_of_a_running_simulator(stand: Callable[..., Stand]) -> None:
    it = stand(RosRobot)
    SteppedRobot(it.ros, SimulatorStarts(it.ros)).release()
    it.environment.reset(seed=1)
    passed = 0.0
    for _ in range(3):
        *_, info = it.environment.step(np.array((0.3, 0.0), np.float32))
        passed += info["duration"]
        assert info["late"] >= 0.0
    assert passed >= 1.2 - 1e-6

    node = it.ros.node  # from here on an operator begins and ends the episodes
    live, said = RosRobot(it.ros, OperatorStarts(it.ros, lambda words: said.append(words))), list[str]()
    environment = RobotEnv(live, it.task, it.interface, it.reward)
    ready, finish = node.create_client(Trigger, f"{NAME}/ready"), node.create_client(SetBool, f"{NAME}/finish")
    it.ros.until(lambda: ready.service_is_ready() and finish.service_is_ready(), "no service")
    ready.call_async(Trigger.Request())
    environment.reset()
    assert "put the robot at its start" in said[0]
    *_, terminated, _, info = environment.step(np.zeros(2, np.float32))
    assert (terminated, info["outcome"]) == (False, "RUNNING")
    finish.call_async(SetBool.Request(data=False))
    *_, terminated, _, info = environment.step(np.zeros(2, np.float32))
    assert (terminated, info["outcome"]) == (True, "COLLISION")


@pytest.mark.usefixtures("bridge", "safety")
def test_a_robot_s_steps_are_counted_on_a_steady_clock(stand: Callable[..., Stand]) -> None:
    it = stand(RosRobot, simulated=False)
    it.environment.reset(seed=1)
    action = np.array((0.2, 0.5), np.float32)
    for _ in range(2):
        *_, info = it.environment.step(action)
    assert info["action"] == pytest.approx(action, abs=1e-5)
    assert info["duration"] > 0.3
    assert info["late_scans"] > 0, "stamps of another clock, here the simulator's, are said"


@pytest.mark.usefixtures("bridge", "safety")
def test_a_policy_is_tuned_goes_on_where_it_was_and_drives_in_the_node(folder: Path, tmp_path: Path) -> None:
    words = ("car_navigation", "--task", folder / "car_navigation.yaml", "--starts", "simulator", "--stepped")
    words = (*words, "--values", folder, "--motion", "--updates", "1", "--folder", tmp_path, "--minutes")
    ros = ("--ros-args", *OPEN)
    process = start("fine_tune", *words, "30", *ros, package="ctrl_rl_learning")
    assert process.stdout is not None
    while "episode 1" not in (line := process.stdout.readline()):
        assert line, process.communicate()[1]
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.rstrip().endswith("fine_tune: interrupted")
    assert "Traceback" not in said

    again = command("fine_tune", *words, "0.01", "--tests", "1", *ros, package="ctrl_rl_learning")
    assert again.returncode == 0, again.stderr
    assert "success    " in again.stdout
    found = json.loads((tmp_path / "result.json").read_text())
    assert len(found["tests"]) == 1
    assert found["episodes"][0]["steps"] == pytest.approx(found["episodes"][0]["seconds"] / 0.4)
    policy = load_policy(tmp_path / "policy.safetensors")
    assert (policy.robot, policy.period, policy.needs) == ("differential_drive", 0.4, {"pose"})
    told = Actor.load(tmp_path / "policy.safetensors").manifest["fine_tuned"]
    assert told == {"seconds": found["seconds"], "episodes": len(found["episodes"])}


def test_a_filter_or_a_simulator_that_dies_is_said(bridge: Any, safety: Any, stand: Callable[..., Stand]) -> None:
    it = stand(SteppedRobot)
    it.environment.reset(seed=3)
    it.environment.step(np.zeros(2, np.float32))
    it.ros.patience = 1.0
    safety.stop(signal.SIGKILL)
    with pytest.raises(LearningError, match="the safety filter is silent"):
        it.environment.step(np.zeros(2, np.float32))
    bridge.stop(signal.SIGKILL)
    with pytest.raises(LearningError, match=r"no (answer|simulator)"):
        it.environment.step(np.zeros(2, np.float32))
    with pytest.raises(LearningError, match=r"no safety filter|sim_bridge/reset"):
        it.environment.reset(seed=4)


def test_commands_that_would_pass_the_filter_by_are_refused() -> None:
    initialise(["test"])
    _, interface = read_policy("car_navigation", motion=False)
    try:
        with pytest.raises(LearningError, match="past the safety filter"):
            LearningNode(interface)
    finally:
        rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("task", "words"),
    [("corridor_doorways", "move in each episode"), ("quad_ttr", "steered by T_1 and T_2")],
)
def test_a_task_that_no_robot_on_the_floor_can_learn_is_refused_in_one_line(task: str, words: str) -> None:
    answer = command("fine_tune", "car_ttr", "--task", task, package="ctrl_rl_learning")
    assert answer.returncode == 1
    (line,) = answer.stderr.splitlines()
    assert words in line

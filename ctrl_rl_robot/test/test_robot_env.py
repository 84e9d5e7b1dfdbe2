"""The environment on real nodes: a bridge, the safety filter, an operator, and what is said when one fails."""

import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from commands import command, start
from ctrl_rl_core.policies.policy import load_policy
from ctrl_rl_core.ros.running import initialise
from ctrl_rl_offline.data.values import _solvable
from ctrl_rl_robot.environment.rewards import StepReward
from ctrl_rl_robot.environment.robot_env import RobotEnv
from ctrl_rl_robot.errors import RobotError
from ctrl_rl_robot.learning.policy import read_policy
from ctrl_rl_robot.nodes.robot_node import NAME, RAW, RobotNode
from ctrl_rl_robot.nodes.ros_robot import Ros, RosRobot, SimulatorStarts
from ctrl_rl_robot.nodes.stepped_robot import SteppedRobot
from ctrl_rl_safety.trials.episodes import CAR
from geometry_msgs.msg import TwistStamped
from ttr_reward_node.rewards.progress import TimeToReach

from ctrl_rl_core import COMMAND, Actor, load_navigation_task, task_digest, task_file
from ttr_reward_node import load_value, problem_from_task, solve

ARGUMENTS = ["--ros-args", "-r", f"{NAME}:cmd_vel:={RAW}"]
OPEN = ("-p", "lidar_x:=0.0", "-p", "min_echo_share:=0.0", "-p", "largest_gap:=6.3")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a task whose lidar looks all around, its time to reach on few cells, and the car's constants."""
    folder = tmp_path_factory.mktemp("robot")
    content = yaml.safe_load(task_file("car_navigation").read_text())
    content["lidar"] |= {"beams": 180, "field": "-180.0 .. 180.0 deg", "placement": "edges"}
    (folder / "car_navigation.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    task = load_navigation_task(str(folder / "car_navigation.yaml"))
    problem = problem_from_task(_solvable(task), counts=(31, 31, 18), inflation=task.robot.radius)
    solve(problem).grid.save(folder / f"car_navigation-{task_digest(task)[:12]}.safetensors")
    CAR.save(folder / "car.yaml")
    return folder


@pytest.fixture(scope="module")
def bridge(folder: Path, run_shared_node: Callable[..., Any]) -> Any:
    return run_shared_node(
        "sim_bridge", "bridge", f"task:={folder}/car_navigation.yaml", "engine:=planar", "physics_rate:=60"
    )


@pytest.fixture(scope="module")
def chain(folder: Path, bridge: Any, run_shared_node: Callable[..., Any]) -> Any:
    """Give the bridge behind the filter."""
    run_shared_node(
        "ctrl_rl_safety",
        "safety_filter",
        f"robot:={folder}/car.yaml",
        "use_sim_time:=true",
        "control_period:=0.11",
        *(word for word in OPEN if word != "-p"),
    )
    return bridge


class Stand:
    """An environment, its node, and the operator's topic."""

    def __init__(self, folder: Path, kind: type[RosRobot], patience: float = 60.0) -> None:
        initialise(["test", *ARGUMENTS, *OPEN, "-p", "use_sim_time:=true"])
        task = load_navigation_task(str(folder / "car_navigation.yaml"))
        _, interface = read_policy("car_navigation", motion=True)
        self.ros = Ros(RobotNode(interface), patience)
        self.operator = self.ros.node.create_publisher(TwistStamped, "cmd_vel_operator", COMMAND)
        (value,) = folder.glob("*.safetensors")
        self.robot = kind(self.ros, SimulatorStarts(self.ros))
        reward = StepReward(task, TimeToReach(load_value(value)))
        self.environment = RobotEnv(self.robot, task, interface, reward)


@pytest.fixture
def stand(folder: Path) -> Iterator[Callable[..., Stand]]:
    stands: list[Stand] = []

    def make(kind: type[RosRobot], patience: float = 60.0) -> Stand:
        stands.append(Stand(folder, kind, patience))
        return stands[-1]

    yield make
    for each in stands:
        each.ros.close()
        rclpy.try_shutdown()


@pytest.mark.usefixtures("chain")
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
    it.ros.until(lambda: it.ros.node.operator.command(it.ros.node.now()) is not None, "no operator")
    *_, info = it.environment.step(forward)
    assert info["operator"] == pytest.approx(1.0)
    assert info["action"] == pytest.approx(((-0.4 + 0.8) / 1.4 - 1.0, 0.5), abs=1e-5)
    it.environment.step(forward)
    *_, info = it.environment.step(forward)
    assert info["operator"] == 0.0, "it is given back when nobody drives it any more"

    changed = 0.0
    for _ in range(10):  # towards a wall or a box, before which the filter holds it
        *_, terminated, _, info = it.environment.step(np.array((1.0, 0.0), np.float32))
        changed = max(changed, info["changed"])
        assert not terminated
    assert changed == 1.0


@pytest.mark.usefixtures("chain")
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


def test_a_policy_is_tuned_goes_on_where_it_was_and_drives_in_the_node(
    chain: Any, folder: Path, tmp_path: Path
) -> None:
    words = ("car_navigation", "--task", folder / "car_navigation.yaml", "--starts", "simulator", "--stepped")
    words = (*words, "--values", folder, "--motion", "--updates", "1", "--folder")
    ros = ("--ros-args", *OPEN)
    first = command("fine_tune", *words, tmp_path, "--minutes", "0.05", *ros, package="ctrl_rl_robot")
    assert first.returncode == 0, first.stderr
    assert "episode 1: " in first.stdout
    again = command("fine_tune", *words, tmp_path, "--minutes", "0.15", "--tests", "1", *ros, package="ctrl_rl_robot")
    assert again.returncode == 0, again.stderr
    assert "episode 1: " not in again.stdout
    assert "episode 2: " in again.stdout
    assert "success    " in again.stdout
    policy = load_policy(tmp_path / "policy.safetensors")
    assert (policy.robot, policy.period, policy.needs) == ("differential_drive", 0.4, {"pose"})
    assert Actor.load(tmp_path / "policy.safetensors").manifest["fine_tuned"]["episodes"] >= 2
    shutil.copy(folder / "car.yaml", tmp_path / "checkpoint.safetensors")
    damaged = command("fine_tune", *words, tmp_path, *ros, package="ctrl_rl_robot")
    assert damaged.returncode == 1
    assert "delete it to begin anew" in damaged.stderr
    # Ctrl-C ends it at once, with the robot at rest.
    process = start("fine_tune", *words, tmp_path / "other", *ros, package="ctrl_rl_robot")
    assert process.stdout is not None
    while "episode 1" not in (line := process.stdout.readline()):
        assert line, process.communicate()[1]
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.rstrip().endswith("fine_tune: interrupted")
    assert "Traceback" not in said
    assert chain.process.poll() is None


@pytest.mark.usefixtures("chain")
def test_a_simulator_that_dies_is_said(bridge: Any, stand: Callable[..., Stand]) -> None:
    it = stand(SteppedRobot)
    it.environment.reset(seed=3)
    it.environment.step(np.zeros(2, np.float32))
    bridge.stop(signal.SIGKILL)
    it.ros.patience = 1.0
    with pytest.raises(RobotError, match=r"no (answer|simulator)"):
        it.environment.step(np.zeros(2, np.float32))
    with pytest.raises(RobotError, match=r"sim_bridge/reset"):
        it.environment.reset(seed=4)


def test_commands_that_would_pass_the_filter_by_are_refused() -> None:
    initialise(["test"])
    _, interface = read_policy("car_navigation", motion=False)
    try:
        with pytest.raises(RobotError, match="past the safety filter"):
            RobotNode(interface)
    finally:
        rclpy.try_shutdown()

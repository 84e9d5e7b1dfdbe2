"""Connect a command to a robot: reward, node and environment."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import rclpy
from ctrl_rl_core.processes import end_with_ros2, interrupt_once
from ctrl_rl_core.ros import initialise

from ctrl_rl_core import NavigationTask, PolicyManifest
from ctrl_rl_learning.offline.data.values import find_time_to_reach
from ctrl_rl_learning.on_robot.environment.rewards import StepReward
from ctrl_rl_learning.on_robot.environment.robot_env import RobotEnv
from ctrl_rl_learning.on_robot.nodes.robot_node import NAME, RAW, LearningNode
from ctrl_rl_learning.on_robot.nodes.ros_robot import OperatorStarts, Ros, RosRobot, SimulatorStarts
from ctrl_rl_learning.on_robot.nodes.stepped_robot import SteppedRobot
from ttr_reward_node import TimeToReach, load_value


@dataclass(frozen=True)
class Connection:
    """How a command reaches and resets a robot.

    Attributes:
        simulator: Whether a simulator, rather than an operator, resets the robot.
        stepped: Whether the simulator pauses while nothing drives.
        values: Folder of times to reach.
    """

    simulator: bool
    stepped: bool
    values: Path


@contextmanager
def connect(
    how: Connection, task: NavigationTask, interface: PolicyManifest, arguments: list[str]
) -> Iterator[RobotEnv]:
    """Yield the environment of the robot on the ROS topics; stop the robot on exit, even after an error.

    Args:
        how: How to reach and reset the robot.
        task: Task to drive.
        interface: Interface of the policy.
        arguments: Command-line arguments, ROS arguments included.

    Raises:
        CtrlRlError: A ROS argument or parameter is wrong, or the simulator does not answer.
    """
    reward = StepReward(task, TimeToReach(load_value(find_time_to_reach(task, how.values))))
    clock = ["-p", "use_sim_time:=true"] if how.simulator else []
    initialise([*arguments, "--ros-args", "-r", f"{NAME}:cmd_vel:={RAW}", *clock])
    end_with_ros2()
    try:
        with interrupt_once(), closing(Ros(LearningNode(interface))) as ros:
            starts = SimulatorStarts(ros) if how.simulator else OperatorStarts(ros, print)
            robot = SteppedRobot(ros, starts) if how.stepped else RosRobot(ros, starts)
            yield RobotEnv(robot, task, interface, reward)
    finally:
        rclpy.try_shutdown()

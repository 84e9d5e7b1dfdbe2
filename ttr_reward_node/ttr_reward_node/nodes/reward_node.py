"""The reward node: odometry in, time to reach and reward out (thesis Fig. 3.2)."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np
from ctrl_rl_core.ros.value_server import Valued
from nav_msgs.msg import Odometry
from numpy.typing import NDArray

from ctrl_rl_core import (
    RESULT,
    SERVER_PARAMETERS,
    Parameter,
    ValueFunction,
    ValueServer,
    load_navigation_task,
    run_node,
)
from ctrl_rl_msgs.msg import TaskOutcome, TaskReward
from ttr_reward_node.rewards.rewards import RewardEvaluator
from ttr_reward_node.values.value_file import load_value


class RewardNode(ValueServer):
    """Serves a time-to-reach function and the reward made of it.

    Subscribes to odom; publishes reward and time_to_reach, one message of each for each odometry message, and ~/grid
    and ~/slice latched. Answers ~/query for many states. Outside the grid it says NaN, never an extrapolation.
    """

    TOPIC = "time_to_reach"
    KIND = "time_to_reach"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *SERVER_PARAMETERS,
        Parameter(
            "task", "", "Name or .yaml file of the task; empty for the one that the grid was made for.", kind="path"
        ),
        Parameter("corridor_width", 0.0, "Width of the task's corridor [m]; 0.0 for the task's own.", 0.0, 100.0),
    )

    def __init__(self) -> None:
        super().__init__("ttr_reward_node")
        self._rewards = self.create_publisher(TaskReward, "reward", RESULT)

    def read(self, path: Path) -> ValueFunction:
        """Read a time-to-reach file."""
        return load_value(path)

    def prepare(self, function: ValueFunction) -> Valued:
        """Return the function that publishes the reward of each state."""
        task = load_navigation_task(self.settings["task"] or function.task)
        evaluator = RewardEvaluator(task, function, self.settings["corridor_width"] or None)
        if not evaluator.up_to_date:
            self.get_logger().warning(
                f"the grid was made for another version of task '{task.name}': solve the task again"
            )

        def publish(message: Odometry, state: NDArray[np.float64], value: float) -> None:
            outcome, reward = evaluator(state, value)
            out = TaskReward(
                header=message.header, outcome=TaskOutcome(value=int(outcome)), reward=reward, time_to_reach=value
            )
            self._rewards.publish(out)

        return publish


def main() -> int:
    """Run the node."""
    return run_node(RewardNode)

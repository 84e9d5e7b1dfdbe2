"""ROS node that converts odometry to the time to reach and the reward (thesis Fig. 3.2)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np
from ctrl_rl_core.ros import Valued
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from std_srvs.srv import Trigger

from ctrl_rl_core import (
    RESULT,
    SERVER_PARAMETERS,
    Parameter,
    ValueFunction,
    ValueServer,
    load_navigation_task,
    run_node,
)
from ctrl_rl_msgs.msg import EpisodeStatus, TaskOutcome, TaskReward
from ttr_reward_node.rewards.progress import ProgressEvaluator, TimeToReach
from ttr_reward_node.rewards.rewards import PROGRESS, EvaluatedReward, RewardEvaluator
from ttr_reward_node.values.value_file import load_value


class RewardNode(ValueServer):
    """Serves a time-to-reach function and the reward derived from it.

    Subscribes to odom; publishes reward and time_to_reach, one message each per odometry message, and ~/grid and
    ~/slice latched. Evaluates many states via the service ~/query. Outside the grid it returns NaN and does not
    extrapolate.

    With `reward:=ttr_progress`, an episode begins with the first odometry message, after a goal, collision or trap,
    with a new number on the simulator's topic `episode`, or by the service ~/begin_episode.
    """

    TOPIC = "time_to_reach"
    KIND = "time_to_reach"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *SERVER_PARAMETERS,
        Parameter(
            "task", "", "Name or .yaml file of the task; empty for the one that the grid was made for.", kind="path"
        ),
        Parameter(
            "reward",
            "ttr",
            "Reward that is published: ttr, minus the time to reach of each state; or ttr_progress, the best progress "
            "since the last message, whose sum over any time is what a robot is paid for it.",
            choices=("ttr", PROGRESS),
        ),
        Parameter("corridor_width", 0.0, "Width of the task's corridor [m]; 0.0 for the task's own.", 0.0, 100.0),
    )

    _progress: ProgressEvaluator | None = None

    def __init__(self) -> None:
        super().__init__("ttr_reward_node")
        self._rewards = self.create_publisher(TaskReward, "reward", RESULT)
        self._episode: int | None = None
        if self.settings["reward"] == PROGRESS:
            self.create_subscription(EpisodeStatus, "episode", self._on_episode, RESULT)
            self.create_service(Trigger, "~/begin_episode", self._on_begin)

    def read(self, path: Path) -> ValueFunction:
        """Read a time-to-reach file."""
        return load_value(path)

    def prepare(self, function: ValueFunction) -> Valued:
        """Return the function that publishes the reward for each state."""
        task = load_navigation_task(self.settings["task"] or function.task)
        evaluator = RewardEvaluator(task, function, self.settings["corridor_width"] or None)
        if not evaluator.up_to_date:
            self.get_logger().warning(
                f"the grid was made for another version of task '{task.name}': solve the task again"
            )

        self._progress = None
        evaluate: Callable[[NDArray[np.float64], float], EvaluatedReward] = evaluator
        if self.settings["reward"] == PROGRESS:
            evaluate = self._progress = ProgressEvaluator(evaluator, TimeToReach(function))

        def publish(message: Odometry, state: NDArray[np.float64], value: float) -> None:
            outcome, reward = evaluate(state, value)
            out = TaskReward(
                header=message.header, outcome=TaskOutcome(value=int(outcome)), reward=reward, time_to_reach=value
            )
            self._rewards.publish(out)

        return publish

    def _on_episode(self, message: EpisodeStatus) -> None:
        """Begin an episode when the simulator begins one."""
        if self._progress is not None and self._episode not in (None, message.episode):
            self._progress.begin()
        self._episode = message.episode

    def _on_begin(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._progress is not None:
            self._progress.begin()
        response.success, response.message = True, "the next odometry begins an episode"
        return response


def main() -> int:
    """Run the node."""
    return run_node(RewardNode)

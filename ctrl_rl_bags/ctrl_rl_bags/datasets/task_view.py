"""Converts frames to the learning data of a task: policy observations, actions in [-1, 1], and rewards.

The values are those of the task's environment in `sim_bridge.environments`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from ctrl_rl_core.policies import ObservationBuilder
from ctrl_rl_core.sensing import planar
from numpy.typing import NDArray

from ctrl_rl_bags.datasets.frames import ACTION, GOAL, ODOMETRY, SCAN, Layout
from ctrl_rl_core import (
    NavigationTask,
    OdometryReader,
    PolicyManifest,
    Sensors,
    interface_of,
    task_names,
    terminal_reward,
)

Array = NDArray[np.float64]
Vectors = NDArray[np.float32]
_LAST_OUTCOME = 4


class TaskView:
    """Converts columns of frames to observations, states, actions and rewards of a task.

    Attributes:
        interface: Observation and commands of the task's policies.
    """

    def __init__(self, task: NavigationTask, layout: Layout, interface: PolicyManifest | None = None) -> None:
        """Set up the conversion for frames of a layout.

        Args:
            task: Task of the drives.
            layout: Layout of the frames.
            interface: Observation and commands; those of the task's policies by default.

        Raises:
            PolicyError: The task's commands cannot be sent by a node.
        """
        self.interface = interface or interface_of(task)
        self._rewards, self._scan = task.rewards, layout.scan.geometry
        self._build, self._state = ObservationBuilder(self.interface), OdometryReader(task.system.build().state_names)
        self._low, self._high = np.array(self.interface.action.low), np.array(self.interface.action.high)

    def observe(self, columns: Mapping[str, NDArray[Any]], before: Array | None = None) -> tuple[Vectors, Array]:
        """Return observations (n, size) and states (n, d) of frames.

        Args:
            columns: Consecutive frames of one episode.
            before: Command before the first frame (2,); the idle command by default.

        Raises:
            PolicyError, ScanError: The scans do not cover a policy's observation.
        """
        seen, states = [], []
        command = np.array(self.interface.rest) if before is None else before
        goals = columns.get(GOAL)
        for row, odometry in enumerate(columns[ODOMETRY]):
            goal = None if goals is None else planar(goals[row].tolist())
            sensors = Sensors(columns[SCAN][row], self._scan, odometry, planar(odometry[:7].tolist()), goal, command)
            seen.append(self._build(sensors))
            states.append(self._state(odometry))
            command = columns[ACTION][row]
        return np.array(seen, dtype=np.float32), np.array(states)

    def actions(self, commands: Array) -> Vectors:
        """Convert commands (n, 2) to actions (n, 2) in [-1, 1], clipped to the limits."""
        shares = 2.0 * (commands - self._low) / (self._high - self._low) - 1.0
        return np.clip(shares, -1.0, 1.0).astype(np.float32)

    def paid(self, outcomes: NDArray[np.int64]) -> Array:
        """Return the task's rewards for outcomes (n,); 0 while an episode is running."""
        known = terminal_reward(np.clip(outcomes, 0, _LAST_OUTCOME), self._rewards)
        return np.where(outcomes == 0, 0.0, known)


def environment_spec(task: NavigationTask, file: str) -> str:
    """Return the Gymnasium specification of a task's environment, as JSON.

    Args:
        task: Navigation task.
        file: File of the task, if it is not one of the suite's.
    """
    spec: dict[str, Any] = {
        "id": f"ctrl_rl/{task.name}-v0",
        "entry_point": "sim_bridge.environments:NavigationEnv",
        "reward_threshold": None,
        "nondeterministic": False,
        "max_episode_steps": task.episode.steps,
        "order_enforce": True,
        "disable_env_checker": False,
        "kwargs": {"task": task.name if task.name in task_names() else file},
        "additional_wrappers": [],
        "vector_entry_point": None,
    }
    return json.dumps(spec)

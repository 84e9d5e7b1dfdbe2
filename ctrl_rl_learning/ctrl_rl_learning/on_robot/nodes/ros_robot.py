"""A robot over ROS topics for the environment: in real time, reset by its operator or by a simulator."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor

from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.on_robot.environment.robot import Driven, StepEnd
from ctrl_rl_learning.on_robot.nodes.robot_node import NAME, RAW, LearningNode
from ctrl_rl_msgs.srv import ResetWorld

Array = NDArray[np.float64]
PATIENCE_S = 10.0
"""Wall time for which an input may be missing before the episode is aborted [s]."""
_SLOWER = 6.0
"""Factor by which a safety filter may take longer at start-up, when it compiles its sets."""
_SPIN_S = 0.02


class Ros:
    """Executor of a node that spins until a condition holds."""

    def __init__(self, node: LearningNode, patience: float = PATIENCE_S) -> None:
        """Create the executor of a node.

        Args:
            node: Node of the robot.
            patience: Wall time to wait for an answer before the episode is aborted [s].
        """
        self.node, self.patience = node, patience
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)

    def spin(self, seconds: float = _SPIN_S) -> None:
        """Handle one message, or wait at most the given time [s]."""
        self._executor.spin_once(timeout_sec=seconds)

    def until(
        self,
        done: Callable[[], bool],
        what: str,
        patience: float | None = None,
        wait: Callable[[], object] | None = None,
    ) -> None:
        """Return once the condition `done` holds; `wait` replaces `spin` to pass the time.

        Raises:
            LearningError: The condition did not hold within `patience` of wall time [s]; `what` names what is missing.
        """
        patience = self.patience if patience is None else patience
        deadline = time.monotonic() + patience
        while not done():
            if time.monotonic() > deadline:
                raise LearningError(f"{what} for {patience:g} s")
            (wait or self.spin)()

    def call(self, client: Any, request: Any) -> Any:
        """Call a service and return its response.

        Raises:
            LearningError: The service is missing or does not answer.
        """
        self.until(client.service_is_ready, f"no simulator: the service {client.srv_name} is missing")
        future = client.call_async(request)
        self.until(future.done, f"no answer from {client.srv_name}")
        return future.result()

    def close(self) -> None:
        """Send a final zero command and shut the node down."""
        self.node.stop()
        self._executor.shutdown()
        self.node.destroy_node()


class Starts(Protocol):
    """How the robot is reset to a start."""

    def begin(self, seed: int) -> None:
        """Reset the robot and set the node's episode number."""


class OperatorStarts:
    """Resets by an operator, who puts the robot back and calls the service ~/ready."""

    def __init__(self, ros: Ros, say: Callable[[str], object]) -> None:
        self._ros, self._say = ros, say

    def begin(self, _seed: int) -> None:
        """Stop the robot and wait for the operator without a time limit."""
        node = self._ros.node
        node.begin_episode(None)
        self._say(f"put the robot at its start, then: ros2 service call /{NAME}/ready std_srvs/srv/Trigger")
        while not node.ready:
            self._ros.spin()


class SimulatorStarts:
    """Resets by a simulator, which draws the start from a seed."""

    def __init__(self, ros: Ros, simulator: str = "sim_bridge") -> None:
        self._ros = ros
        self._client = ros.node.create_client(ResetWorld, f"{simulator}/reset")

    def begin(self, seed: int) -> None:
        """Begin an episode.

        Raises:
            LearningError: The simulator refuses, or does not answer.
        """
        response = self._ros.call(self._client, ResetWorld.Request(seed=seed))
        if not response.success:
            raise LearningError(f"the simulator cannot begin an episode: {response.message}")
        self._ros.node.begin_episode(response.episode)


class RosRobot:
    """Robot timed by its own clock: real time or the simulator's time."""

    def __init__(self, ros: Ros, starts: Starts) -> None:
        self._ros, self._starts = ros, starts

    def now(self) -> float:
        """Return steady time or the simulator's time [s]."""
        return self._ros.node.robot.now()

    def begin(self, seed: int) -> StepEnd:
        """Reset the robot to a start; keep it still until the filter has answered and all inputs are fresh."""
        node = self._ros.node
        self._ros.until(
            node.is_filtered, f"no safety filter takes {RAW}: start it, see --help; none", self._ros.patience * _SLOWER
        )
        node.rest()
        self._starts.begin(seed)
        scans, node.status_of_filter = node.scans, None
        node.hold(np.zeros(2))
        self.advance(self.now())
        self._ros.until(lambda: node.scans > scans, "no scan")
        self.await_inputs()
        self._ros.until(lambda: node.status_of_filter is not None, "no answer from the safety filter")
        node.begin_step(self.now())
        return self.read()

    def drive(self, command: Array, until: float) -> Driven:
        """Send a command (2,) until a time [s]."""
        node = self._ros.node
        node.begin_step(self.now())
        node.hold(command)
        self.advance(until)
        self.await_inputs()  # the robot stands still while this waits; the time counts as a missed step
        return node.end_step(self.now())

    def advance(self, until: float) -> None:
        """Let time pass until a time [s].

        Raises:
            LearningError: The clock stands still, or the safety filter is silent.
        """
        node, moved, last = self._ros.node, time.monotonic(), self.now()
        heard, word = time.monotonic(), node.status_of_filter
        while self.now() < until:
            self._ros.spin(min(_SPIN_S, max(until - self.now(), 0.001)))
            wall = time.monotonic()
            if self.now() != last:
                moved, last = wall, self.now()
            if node.status_of_filter is not word:
                heard, word = wall, node.status_of_filter
            if wall - moved > self._ros.patience:
                raise LearningError("the clock stands still: has the simulator ended or been paused?")
            if wall - heard > self._ros.patience:
                raise LearningError("the safety filter is silent: the robot does not drive without it")

    def read(self) -> StepEnd:
        """Return the sensor readings once all inputs are usable; the waiting time belongs to the next step."""
        self.await_inputs()
        return self._ros.node.reading(self.stamp_now())

    def await_inputs(self) -> None:
        """Wait until scan and odometry are usable.

        Raises:
            LearningError: They remain unusable.
        """
        node = self._ros.node
        problem = node.robot.input_fault()
        if problem:
            self._ros.until(lambda: not node.robot.input_fault(), problem, wait=self._pass_time)

    def _pass_time(self) -> None:
        """Let a little time pass."""
        self._ros.spin()

    def stamp_now(self) -> float:
        """Return the current time on the clock of message stamps [s]."""
        return float(self._ros.node.get_clock().now().nanoseconds) * 1e-9

    def stand(self) -> None:
        """Stop the robot."""
        self._ros.node.rest()

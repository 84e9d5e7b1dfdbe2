"""Node that drives or flies a robot with any learnt policy: `ros2 run ctrl_rl_core policy`."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray

from ctrl_rl_core.driving.driver_node import DRIVER_PARAMETERS, MAX_DISTANCE, DriverNode, NodeDriver
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.path_node_driver import PATH_PARAMETERS, follow_paths
from ctrl_rl_core.policies.policy import Policy, find_policy, load_policy, policy_digest
from ctrl_rl_core.policies.pose_input import POSE_PARAMETERS, PoseInput
from ctrl_rl_core.ros.node import COMMAND
from ctrl_rl_core.ros.parameters import Parameter
from ctrl_rl_core.ros.running import run_node
from ctrl_rl_core.sensing.pose import PoseError, planar, read_goal
from ctrl_rl_core.sensing.scan import Sensors
from ctrl_rl_msgs.msg import EpisodeStatus

Array = NDArray[np.float64]


class PolicyNodeDriver(NodeDriver):
    """The policy of a file; decides at each scan or once per period."""

    def __init__(self, node: DriverNode) -> None:
        """Load the policy named by the node's parameter, and subscribe to its pose and goal."""
        self._node, self._settings = node, node.settings
        self._decided_at = self._scanned_at = math.nan
        self._episode: int | None = None
        self._goal: tuple[Array, str] | None = None
        self._take(*self._read(self._settings["policy"]))
        if self._policy.robot == "planar_quadrotor":
            self.thrusts_at_rest = self._policy.rest
        self._poses = PoseInput(node, float(self._settings["scan_timeout"]), lambda: node.robot.now())
        node.create_subscription(PoseStamped, "goal_pose", self._on_goal, COMMAND)

    def command(self, sensors: Sensors) -> Array:
        """Return the policy's command, or the previous one until its period is over.

        Raises:
            CtrlRlError: A component of the observation is missing.
        """
        now = sensors.time
        if self._is_due(now):
            self._decided_at = math.nan  # after an error, decide at the next scan
            self._command = self._decide(sensors)
            self._decided_at = now
        return self._command

    def on_odometry(self, message: Odometry) -> None:
        """Store the pose for the next decision."""
        self._poses.on_odometry(message, self._node.robot.frame)

    def on_episode(self, message: EpisodeStatus) -> None:
        """Make a new decision when an episode starts."""
        if message.episode != self._episode:
            self._episode = message.episode
            self._forget()

    def forget(self) -> None:
        """Drop the goal."""
        self._goal = None

    def use_parameter(self, name: str) -> None:
        """Load another policy, used from the next scan on.

        Raises:
            PolicyError: The policy cannot be loaded, or is for another kind of robot.
        """
        if name != "policy":
            return
        policy, file = self._read(self._settings["policy"])
        if policy.robot != self._policy.robot:
            raise PolicyError(f"{file.name} is for a {policy.robot}, this node moves a {self._policy.robot}")
        self._take(policy, file)

    def figures(self) -> Mapping[str, object]:
        """Return the name of the active policy."""
        return self._served | ({"refused pose": self._poses.refused} if self._poses.refused else {})

    def _decide(self, sensors: Sensors) -> Array:
        policy, tolerance = self._policy, self._settings["goal_tolerance"]
        pose, goal = sensors.pose, sensors.goal
        if pose is None and "pose" in policy.needs:
            pose = self._poses.pose()
        if goal is None and "goal" in policy.needs:
            if self._goal is None:
                raise PolicyError("waiting for goal_pose")
            goal = self._poses.place(*self._goal)
            if pose is not None and tolerance > 0.0 and math.dist(pose[:2], goal[:2]) <= tolerance:
                return policy.rest
        return self._node.robot.clip(policy.command(sensors._replace(pose=pose, goal=goal)))

    def _is_due(self, now: float) -> bool:
        """Return whether the scan at a time [s] is the one nearest to the end of the period."""
        gap = now - self._scanned_at
        self._scanned_at = now
        period, elapsed = self._policy.period, now - self._decided_at
        if period is None or not elapsed > 0.0:  # NaN, or a clock that stands still or was set back
            return True
        return elapsed >= period - 0.5 * min(max(gap, 0.0), period)

    def _on_goal(self, message: PoseStamped) -> None:
        try:
            goal = planar(read_goal(message.pose).tolist())
        except PoseError as error:
            self._node.get_logger().warning(f"goal_pose refused: {error}")
            return
        self._goal = goal, message.header.frame_id.lstrip("/")
        self._decided_at = math.nan
        self._node.get_logger().info(f"goal ({goal[0]:.2f}, {goal[1]:.2f}) m in '{self._goal[1]}'")

    def _read(self, name: str) -> tuple[Policy, Path]:
        file = find_policy(name)
        return load_policy(file), file

    def _take(self, policy: Policy, file: Path) -> None:
        digest = policy_digest(file)
        self._policy, self.limits = policy, policy.limits
        self._served: dict[str, object] = {"policy": file.name, "policy digest": digest, "robot": policy.robot}
        self._forget()
        period = "at each scan" if policy.period is None else f"every {policy.period:g} s"
        self._node.get_logger().info(f"policy {file.name} ({digest[:12]}): {policy.description}; it decides {period}")

    def _forget(self) -> None:
        """Reset the period, so the next scan triggers a decision."""
        self._command, self._decided_at, self._scanned_at = self._policy.rest, math.nan, math.nan


class PolicyNode(DriverNode):
    """Drives a wheeled robot, or flies a planar quadrotor, with the policy of a file.

    Subscribes to scan, odom, goal_pose, episode and the topic selected by the parameter `pose`; publishes cmd_vel, or
    rotor_thrusts for a quadrotor. Each command carries the stamp of the scan that triggered it. A policy with a period
    decides once per period and holds its command in between; each scan limits that command again. If a component of the
    observation is missing or stale, the robot stops, or a quadrotor receives hover thrust. The policy can be replaced
    by another one for the same kind of robot while driving. With follow_path it serves that action of Nav2.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *DRIVER_PARAMETERS,
        Parameter(
            "policy",
            "",
            "Policy: a name of those that come with the packages, a .safetensors file, or an .onnx file with its .yaml "
            "beside it; a new one drives from the next scan on.",
            live=True,
            kind="path",
        ),
        *POSE_PARAMETERS,
        *PATH_PARAMETERS,
        Parameter(
            "goal_tolerance",
            0.0,
            "Distance from goal_pose at which the robot stands [m]; 0.0 to leave the arrival to the policy.",
            0.0,
            100.0,
            live=True,
        ),
        MAX_DISTANCE,
    )

    def __init__(self) -> None:
        super().__init__("policy", follow_paths(PolicyNodeDriver))


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_core policy`."""
    return run_node(PolicyNode)


if __name__ == "__main__":
    sys.exit(main())

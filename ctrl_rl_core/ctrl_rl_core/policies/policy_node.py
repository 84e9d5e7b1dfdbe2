"""The node that drives or flies a robot by any learnt policy: `ros2 run ctrl_rl_core policy`."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import ClassVar

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray

from ctrl_rl_core.driving.command_output import CommandOutput, ThrustOutput
from ctrl_rl_core.driving.episode_driver import MAX_DISTANCE, EpisodeDriver
from ctrl_rl_core.driving.lidar_driver import DRIVER_PARAMETERS, PendingDecision, SensorReading
from ctrl_rl_core.driving.velocity_node import VelocityError
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.policy import Policy, find_policy, load_policy, policy_digest
from ctrl_rl_core.policies.pose_input import POSE_PARAMETERS, PoseInput
from ctrl_rl_core.ros.node import COMMAND, Status, seconds
from ctrl_rl_core.ros.parameters import Parameter
from ctrl_rl_core.ros.running import run_node
from ctrl_rl_core.sensing.pose import PoseError, planar, read_goal
from ctrl_rl_core.sensing.sensors import Sensors
from ctrl_rl_msgs.msg import EpisodeStatus

Array = NDArray[np.float64]


class PolicyNode(EpisodeDriver):
    """Drives a robot on wheels, or flies a planar quadrotor, by the policy of a file.

    Subscribes to scan, odom, goal_pose, episode and what the parameter `pose` names; publishes cmd_vel, or
    rotor_thrusts for a quadrotor. Each command carries the stamp of the scan that it answers. A policy with a period of
    its own decides once in a period and holds its command between, which each scan limits anew. Where a part of the
    observation is missing or too old, the robot stands still, and a quadrotor gets the thrusts that carry its weight.
    Another policy for the same kind of robot may be given while it drives.
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
        self._scanned_at = self._decided_at = math.nan
        super().__init__("policy")
        self.set_limits(*self._policy.limits)
        self._odometry: Array | None = None
        self._goal: Array | None = None
        self._goal_frame = ""
        self._episode: int | None = None
        self._poses = PoseInput(self, self.timeout, lambda: self._ages.now().nanoseconds * 1e-9)
        self.create_subscription(PoseStamped, "goal_pose", self._on_goal, COMMAND)

    def make_output(self) -> CommandOutput:
        """Return cmd_vel or rotor_thrusts, as the robot of the policy takes them."""
        self._take(*self._read(self.settings["policy"]))
        if self._policy.robot == "planar_quadrotor":
            return ThrustOutput(self, self._policy.rest)
        return super().make_output()

    def on_parameter_changed(self, name: str) -> None:
        """Apply a parameter; a new policy drives from the next scan on."""
        if name != "policy":
            super().on_parameter_changed(name)
            return
        policy, file = self._read(self.settings["policy"])
        if policy.robot != self._policy.robot:
            raise PolicyError(f"{file.name} is for a {policy.robot}, this node moves a {self._policy.robot}")
        self._take(policy, file)
        self.set_limits(*policy.limits)

    def on_odometry(self, message: Odometry, odometry: Array) -> None:
        """Keep it for the next decision."""
        super().on_odometry(message, odometry)
        self._odometry = odometry
        self._poses.on_odometry(message, self.frame)

    def on_episode(self, message: EpisodeStatus) -> None:
        """Decide anew when an episode begins."""
        if message.episode != self._episode:
            self._episode = message.episode
            self._forget()

    def make_safe(self, command: Array) -> tuple[Array, str]:
        """Return the safe part of a command (2,) by the last scan; thrusts pass as they are while the input is fit."""
        if self._policy.robot != "planar_quadrotor":
            return super().make_safe(command)
        problem = self.input_fault()
        if problem:
            raise VelocityError(problem)
        return command, ""

    def decide(self, reading: SensorReading) -> PendingDecision:
        """Return the policy's command, or the one before until its period is over.

        Raises:
            CtrlRlError: A part of the observation is missing, or the drive is over.
        """
        now = seconds(reading.header.stamp)
        self.check_drive(now, reading.v)
        if self._is_due(now):
            self._command = self._decide(reading)
            self._decided_at = now
        return PendingDecision(self._command)

    def status(self) -> Status:
        """Return whether commands flow, and which policy gives them."""
        level, message, figures = super().status()
        refused = {"refused pose": self._poses.refused} if self._poses.refused else {}
        return level, message, {**figures, **self._served, **refused}

    def _decide(self, reading: SensorReading) -> Array:
        policy = self._policy
        self._decided_at = math.nan  # after an error the next scan decides anew
        assert self._odometry is not None  # the input is fit
        pose = self._poses.pose() if "pose" in policy.needs else None
        goal = None
        if "goal" in policy.needs:
            if self._goal is None:
                raise PolicyError("waiting for goal_pose")
            goal = self._poses.place(self._goal, self._goal_frame)
            tolerance = self.settings["goal_tolerance"]
            if pose is not None and tolerance > 0.0 and math.dist(pose[:2], goal[:2]) <= tolerance:
                return self.output.rest
        sensors = Sensors(reading.ranges, reading.scan, self._odometry, pose, goal, self._command)
        return self.clip(policy.command(sensors))

    def _is_due(self, now: float) -> bool:
        """Return whether the scan at a time [s] is the nearest to the end of the period."""
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
            self.get_logger().warning(f"goal_pose refused: {error}")
            return
        self._goal, self._goal_frame = goal, message.header.frame_id.lstrip("/")
        self._decided_at = math.nan
        self.get_logger().info(f"goal ({goal[0]:.2f}, {goal[1]:.2f}) m in '{self._goal_frame}'")

    def _read(self, name: str) -> tuple[Policy, Path]:
        file = find_policy(name)
        return load_policy(file), file

    def _take(self, policy: Policy, file: Path) -> None:
        digest = policy_digest(file)
        self._policy = policy
        self._served = {"policy": file.name, "policy digest": digest, "robot": policy.robot}
        self._forget()
        period = "at each scan" if policy.period is None else f"every {policy.period:g} s"
        self.get_logger().info(f"policy {file.name} ({digest[:12]}): {policy.description}; it decides {period}")

    def _forget(self) -> None:
        """Let the next scan decide, as if no command had been sent."""
        self._command, self._decided_at, self._scanned_at = self._policy.rest, math.nan, math.nan


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_core policy`."""
    return run_node(PolicyNode)


if __name__ == "__main__":
    sys.exit(main())

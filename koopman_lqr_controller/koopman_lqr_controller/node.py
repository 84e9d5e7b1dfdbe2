"""The controller node: scan and odometry in, velocity and latent state out."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from ctrl_rl_core.parameters import Parameter
from ctrl_rl_core.ros import RESULT, run_node
from numpy.typing import NDArray
from rclpy.time import Time

from ctrl_rl_msgs.msg import LatentState
from koopman_lqr_controller.lidar_driver import DRIVER_PARAMETERS, LidarDriver, Sensed
from koopman_lqr_controller.policy import Decision, DrivingPolicy
from koopman_lqr_controller.policy_file import digest, find_policy, load_policy

_SAME_STEP = 0.5
"""A scan that comes earlier or later than the model's step by more than this part of it is not what was predicted."""


class Controller(LidarDriver):
    """Drives a robot from its lidar with a Koopman-LQR policy.

    Subscribes to scan and odom, publishes cmd_vel and ~/latent. Each cmd_vel carries the stamp of the scan that it
    answers. Without a recent, usable scan and odometry the robot stands still.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *DRIVER_PARAMETERS,
        Parameter("policy", "curved_corridor_edmd", "A policy that comes with the package, or a .safetensors file."),
    )

    def __init__(self) -> None:
        super().__init__("koopman_lqr_controller")
        path = find_policy(self.settings["policy"])
        self._policy: DrivingPolicy = load_policy(path)
        sectors = len(self._policy.sectors.bearings)  # a policy of another kind of robot ends here
        self._latent = self.create_publisher(LatentState, "~/latent", RESULT)
        self._last: Decision | None = None
        self._last_at = 0.0
        self.get_logger().info(
            f"policy {path.name} ({digest(path)[:12]}), {len(self._policy.z_ref)} observables, {sectors} sectors"
        )

    def halted(self) -> None:
        """Forget the prediction: it was made for a robot that goes on."""
        self._last = None

    def decide(self, sensed: Sensed) -> NDArray[np.float64]:
        """Return the policy's command and publish how it came about."""
        decision = self._policy.decide(sensed.ranges, sensed.scan, sensed.v, sensed.omega)
        out = LatentState(
            header=sensed.header,
            z=decision.z,
            control=decision.control,
            cost_to_go=decision.cost_to_go,
            prediction_error=float("nan"),
        )
        now = Time.from_msg(sensed.header.stamp).nanoseconds * 1e-9
        if self._last is not None and self._in_step(now - self._last_at):
            out.z_predicted = self._last.z_next
            out.prediction_error = float(np.linalg.norm(decision.z - self._last.z_next))
        self._last, self._last_at = decision, now
        self._latent.publish(out)
        return decision.command

    def _in_step(self, seconds: float) -> bool:
        """Whether so much time since the last scan is what the model predicts for."""
        dt = self._policy.dt
        return dt is None or abs(seconds / dt - 1.0) < _SAME_STEP


def main() -> int:
    """Run the node."""
    return run_node(Controller)

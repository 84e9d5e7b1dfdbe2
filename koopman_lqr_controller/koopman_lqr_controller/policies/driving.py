"""Koopman policies for `ros2 run ctrl_rl_core policy`, which finds them by the entry point group `ctrl_rl.policies`.

The region of training is watched there, too; the prediction error only by the controller of this package.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ctrl_rl_core import PolicyKind, Sensors
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.policies.policy_file import KoopmanPolicy, load_policy, shipped_policies

LARGEST_DISTANCE = 1.3
"""Distance from the latents of training that stops the robot, over that of 99.9 % of them."""


class DrivingPolicy:
    """A Koopman policy that drives a robot on wheels; it decides at each scan."""

    def __init__(self, policy: KoopmanPolicy) -> None:
        self._policy = policy
        self.robot, self.needs = "differential_drive", frozenset[str]()
        self.period: float | None = None
        self.limits = policy.limits
        self.rest: Array = np.zeros(2)
        kind = policy.closed_loop_model().kind
        self.description = f"a Koopman policy ({kind}) of {len(policy.z_ref)} observables"

    def command(self, sensors: Sensors) -> Array:
        """Return speed [m/s] and turn rate [rad/s] (2,).

        Raises:
            ScanError: Nothing can be seen in the scan.
            KoopmanError: The latent is not as in training.
        """
        decision = self._policy.decide(sensors.ranges, sensors.scan, *sensors.speeds)
        distribution = self._policy.distribution
        if distribution is not None and distribution.relative_distance(decision.z) > LARGEST_DISTANCE:
            raise KoopmanError("the latent has left the region seen in training")
        return decision.command


def load_driving_policy(path: Path) -> DrivingPolicy:
    """Return the policy of a file.

    Raises:
        KoopmanError: It holds none, or one of a task without a lidar.
    """
    return DrivingPolicy(load_policy(path))


KIND = PolicyKind(load_driving_policy, shipped_policies)

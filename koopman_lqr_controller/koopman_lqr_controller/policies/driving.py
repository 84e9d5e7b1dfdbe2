"""Koopman policies for `ros2 run ctrl_rl_core policy`, found through the entry point group `ctrl_rl.policies`.

The training region is monitored there too; the prediction error only by this package's controller.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ctrl_rl_core import PolicyKind, Sensors
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.policies.network import LARGEST_DISTANCE, describe_policy
from koopman_lqr_controller.policies.policy_file import KoopmanPolicy, load_policy, shipped_policies


class DrivingPolicy:
    """A Koopman policy that drives a wheeled robot; decides at each scan."""

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
            ScanError: The scan has no measurement.
            KoopmanError: The latent is outside the training region.
        """
        decision = self._policy.decide(sensors.ranges, sensors.scan, *sensors.speeds)
        distribution = self._policy.distribution
        if distribution is not None and distribution.relative_distance(decision.z) > LARGEST_DISTANCE:
            raise KoopmanError("the latent has left the region seen in training")
        return decision.command


def load_driving_policy(path: Path) -> DrivingPolicy:
    """Load the policy of a file.

    Raises:
        KoopmanError: The file has no policy, or one for a task without a lidar.
    """
    return DrivingPolicy(load_policy(path))


KIND = PolicyKind(load_driving_policy, shipped_policies, describe_policy)

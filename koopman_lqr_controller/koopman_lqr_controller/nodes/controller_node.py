"""The controller node: receives scans and odometry, publishes velocity and latent state."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np
from ctrl_rl_core.policies import PATH_PARAMETERS, POSE_PARAMETERS, follow_paths
from ctrl_rl_core.ros import seconds
from numpy.typing import NDArray
from std_msgs.msg import Header

from ctrl_rl_core import (
    DRIVER_PARAMETERS,
    MAX_DISTANCE,
    RESULT,
    DriverNode,
    NodeDriver,
    Parameter,
    ScanGeometry,
    Sensors,
    run_node,
)
from ctrl_rl_msgs.msg import LatentState
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.policies.koopman_policy import Decision
from koopman_lqr_controller.policies.policy_file import DEFAULT_POLICY, KoopmanPolicy, digest, find_policy, load_policy
from koopman_lqr_controller.safety.guards import Guard
from koopman_lqr_controller.sensing.lidar_observation import STEP_TOLERANCE

_OUT_OF_STEP = 20
"""Number of consecutive unpredicted scans after which a warning is logged."""
_SOME_SCAN = ScanGeometry(360, 0.0, 2.0 * np.pi / 360, 0.1, 3.5)
_LIMITS, _RETRIES = ("largest_distance", "largest_error", "error_patience"), ("retry_after", "most_retries")


class _LatentDetails(NamedTuple):
    """Details of one decision in the latent space.

    Attributes:
        decision: Command, control and latent of the policy.
        predicted: Latent predicted by the model for this scan (n,); None without a prediction.
        error: |z - z_predicted|; NaN without a prediction.
        distance: Distance of the latent relative to the border's; NaN without a distribution.
        measured: Odometry speed [m/s] and turn rate [rad/s].
    """

    decision: Decision
    predicted: NDArray[np.float64] | None
    error: float
    distance: float
    measured: tuple[float, float]


class LatentDriver(NodeDriver):
    """Drives with a Koopman policy, stops outside its training region, and publishes the details of each command."""

    def __init__(self, node: DriverNode) -> None:
        """Load the policy named by the node's parameter."""
        self._node, self._settings = node, node.settings
        self._latent = node.create_publisher(LatentState, "~/latent", RESULT)
        self._policy: KoopmanPolicy
        self._next: NDArray[np.float64] | None = None
        self._next_since = math.nan
        self._details: _LatentDetails | None = None
        self._load(self._settings["policy"])

    def command(self, sensors: Sensors) -> NDArray[np.float64]:
        """Return the policy's command.

        Raises:
            KoopmanError: There is no command, or the latent is outside the training region.
        """
        now, predicted, error = sensors.time, None, math.nan
        v, omega = sensors.speeds
        decision = self._policy.decide(sensors.ranges, sensors.scan, v, omega)
        if self._next is not None and self._in_step(now - self._next_since):
            predicted = self._next
            missed = decision.z - predicted
            error = math.sqrt(missed.dot(missed))
        stop = self._guard.update(now, decision.z, error)
        self._details = _LatentDetails(decision, predicted, error, self._guard.distance, (v, omega))
        if stop:
            raise KoopmanError(stop)
        return self._guard.speed_scale * decision.command

    def on_sent(self, header: Header, command: NDArray[np.float64], problem: str) -> None:
        """Publish the details of the command, and predict the resulting latent."""
        dry, nan, details = self._settings["dry_run"], math.nan, self._details
        out = LatentState(header=header, prediction_error=nan, cost_to_go=nan, distance=nan, stop=problem, dry_run=dry)
        out.command = _doubles(command)
        self._next = self._details = None  # without a decision there is no basis for a prediction
        if details is None:
            out.z, out.control = _doubles(np.full_like(self._policy.z_ref, nan)), _doubles(np.full(2, nan))
        else:
            z = details.decision.z
            out.z, out.control = _doubles(z), _doubles(details.decision.control)
            out.cost_to_go, out.distance = self._policy.cost_to_go(z), details.distance
            if details.predicted is not None:
                out.z_predicted, out.prediction_error = _doubles(details.predicted), details.error
            # In a dry run, someone else drives, or no one: the executed motion is that of odometry.
            self._next = self._policy.predict(z, np.array(details.measured) if dry else command)
            self._next_since = seconds(header.stamp)
        self._latent.publish(out)

    def use_parameter(self, name: str) -> None:
        """Apply a changed parameter; a new policy is used from the next scan on.

        Raises:
            KoopmanError: The policy is unusable; the previous one stays in use.
        """
        if name == "policy":
            self._load(self._settings["policy"])
        elif name in (*_LIMITS, *_RETRIES):
            self._set_guard()

    def figures(self) -> Mapping[str, object]:
        """Report the active policy and the robot's distance from its training region."""
        return self._served | {
            "distance over the region's": self._not_watched("largest_distance") or f"{self._guard.distance:.2f}",
            "prediction": self._not_watched("largest_error") or self._out_of_step or "watched",
            "retries": f"{self._guard.retries.used} of {self._guard.retries.most}",
        }

    def _load(self, name: str) -> None:
        """Load, test and activate a policy.

        Raises:
            KoopmanError: The policy is unusable; the previous one stays in use.
        """
        path = find_policy(name)
        policy = load_policy(path)
        policy.decide(np.ones(_SOME_SCAN.beams, np.float32), _SOME_SCAN, 0.0, 0.0)  # raises for another robot's policy
        served: dict[str, object] = {"policy": path.name, "policy digest": digest(path)}
        # Replace the active policy only by a fully valid one.
        self._guard, self._served, self._next = Guard(policy.distribution, 0.0, 0.0, 0.0), served, None
        self._set_guard()
        self._late, self._out_of_step = 0, ""
        self._policy, self.limits = policy, policy.limits
        self._node.get_logger().info(
            f"policy {path.name} ({str(served['policy digest'])[:12]}), {len(policy.z_ref)} observables, "
            f"{len(policy.sectors.bearings)} sectors"
        )
        if policy.distribution is None:
            self._node.get_logger().warning(
                f"{path.name} has no region of training: only stale and unusable input stops the robot"
            )

    def _set_guard(self) -> None:
        self._guard.set_limits(*(float(self._settings[name]) for name in _LIMITS))
        self._guard.set_retries(*(self._settings[name] for name in _RETRIES))

    def _in_step(self, elapsed: float) -> bool:
        """Return whether the time [s] since the last scan matches the model's step; warn if it never does."""
        dt = self._policy.dt
        if dt is None or abs(elapsed / dt - 1.0) < STEP_TOLERANCE:
            self._late, self._out_of_step = 0, ""
            return True
        self._late += 1
        if self._late >= _OUT_OF_STEP and not self._out_of_step:
            self._out_of_step = f"not watched: scans come every {elapsed:.2f} s, the model's step is {dt:.2f} s"
            self._guard.reset_prediction_alarm()
            self._node.get_logger().warning(f"prediction error {self._out_of_step}")
        return False

    def _not_watched(self, limit: str) -> str:
        """Return why the limit set by a parameter has no effect, or "" if it has."""
        if self._policy.distribution is None:
            return "not watched: the policy's file has no region"
        return "" if self._settings[limit] > 0.0 else f"not watched: {limit} is 0.0"


class Controller(DriverNode):
    """Drives a robot from its lidar with a Koopman LQR policy.

    Subscribes to scan and odom, publishes cmd_vel and ~/latent. Each cmd_vel carries the stamp of the scan that
    triggered it. The robot stops without a recent, usable scan and odometry, outside the policy's training region, and
    while the policy's model predicts poorly. The policy can be replaced at run time. With follow_path it serves that
    action of Nav2.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *DRIVER_PARAMETERS,
        Parameter(
            "policy",
            DEFAULT_POLICY,
            "Policy of the package by name, or a .safetensors file; a new one drives from the next scan on.",
            live=True,
            kind="path",
        ),
        Parameter(
            "largest_distance",
            1.3,
            "Distance from the latents of training that stops the robot, over that of 99.9 % of them; 0.0 for none.",
            0.0,
            1000.0,
            live=True,
        ),
        Parameter(
            "largest_error",
            1.0,
            "Prediction error that stops the robot if it stays, over that of 99 % of training; 0.0 for none.",
            0.0,
            1000.0,
            live=True,
        ),
        Parameter(
            "error_patience", 1.0, "Time that the prediction error may stay too large [s].", 0.0, 60.0, live=True
        ),
        Parameter(
            "retry_after",
            3.0,
            "Time that the robot stands for its prediction error before it tries again at half speed [s].",
            0.0,
            600.0,
            live=True,
        ),
        Parameter("most_retries", 5, "Largest number of retries in a row; 0 for none.", 0, 1000, live=True),
        MAX_DISTANCE,
        *POSE_PARAMETERS,
        *PATH_PARAMETERS,
    )

    def __init__(self) -> None:
        super().__init__("koopman_lqr_controller", follow_paths(LatentDriver))


def _doubles(values: NDArray[np.float64]) -> array[float]:
    """Convert `values` to the array type that a float64[] field takes directly; faster than an ndarray."""
    return array("d", values.tobytes())


def main() -> int:
    """Run the node."""
    return run_node(Controller)

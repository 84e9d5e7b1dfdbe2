"""Koopman policies as networks for export: lift and law in one, with the distance from training as second output."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ctrl_rl_core import PolicyDescription, PolicyManifest, Sensors
from ctrl_rl_core import networks as layers
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.encoder import EPSILON, Dense, Encoder, LayerNorm, Rectifier
from koopman_lqr_controller.policies.edmd_policy import EdmdPolicy
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.policies.policy_file import KoopmanPolicy, load_policy
from koopman_lqr_controller.safety.guards import LatentDistribution

LARGEST_DISTANCE = 1.3
"""Distance from the training latents that stops the robot, relative to that of 99.9 % of them."""
_REMARKS = (
    "The controller of `koopman_lqr_controller` also stops a robot whose prediction error stays high; this needs its "
    "linear model, which the ONNX model does not contain.",
    "The node refuses a lidar that does not look all around. Driven by its own file, the policy fills in what such a "
    "lidar does not see from the neighbouring sectors.",
)


def describe_policy(path: Path) -> PolicyDescription:
    """Describe the policy of a file for export.

    Raises:
        KoopmanError: The file has no policy, or one with layers that cannot be exported.
    """
    policy = load_policy(path)
    if isinstance(policy, EdmdPolicy):
        return _describe_edmd(policy)
    return _describe_latent(policy) if policy.robot_interface is not None else _describe_without_robot(policy)


def _describe_edmd(policy: EdmdPolicy) -> PolicyDescription:
    seen, half = policy.observables, len(policy.observables.bearings_deg)
    lift = np.zeros((half + 2, 2 * half + 2))
    lift[np.arange(half), half + np.arange(half)] = 1.0  # left at each bearing, less right
    lift[np.arange(half), half - 1 - np.arange(half)] = -1.0
    lift[half:, 2 * half :] = ((0.0, 1.0), (1.0, 0.0))  # turn rate, then speed
    scan = {
        "source": "scan",
        "count": 2 * half,
        "at": list(policy.sectors.bearings),
        "half_width": policy.sectors.half_width,
        "reduce": "median",
        "low": seen.closest,
        "high": seen.far,
    }
    middle, span = 0.5 * (policy.u_low + policy.u_high), 0.5 * (policy.u_high - policy.u_low)
    law = layers.Dense(-policy.K / span[:, None], (policy.u_ref + policy.K @ policy.z_ref - middle) / span)
    trunk = (layers.Nearness(2 * half, seen.near), layers.Dense(lift, np.zeros(half + 2)))
    return _described(policy, trunk, (law, layers.Clip(-1.0, 1.0)), scan, (1.0, 1.0))


def _describe_latent(policy: LatentPolicy) -> PolicyDescription:
    interface = policy.required_interface
    seen = interface.observation
    scan = {
        "source": "scan",
        "count": seen.count,
        "step": 2.0 * np.pi / seen.count,
        "half_width": np.pi / seen.count,
        "reduce": "median",
        "low": seen.closest,
        "high": seen.far,
    }
    trunk = (layers.Nearness(seen.count, seen.near), *_encoder(policy))
    return _described(policy, trunk, _law(policy), scan, (seen.speed, seen.turn))


def _describe_without_robot(policy: LatentPolicy) -> PolicyDescription:
    encoder = policy.controller.encoder
    if len(encoder.shape) != 1:
        raise KoopmanError(f"observes pictures of shape {encoder.shape}: only vectors can be exported")
    return PolicyDescription(
        network=layers.Network(encoder.shape[0], tuple(_encoder(policy)), {"action": _law(policy)}),
        outputs=lambda x: {"action": policy.controller.action(x)},
        training=policy.manifest,
        remarks=("No node drives by it: its task has no lidar. Actions are in [-1, 1].",),
    )


def _described(
    policy: KoopmanPolicy,
    trunk: tuple[layers.Layer, ...],
    law: tuple[layers.Layer, ...],
    scan: dict[str, Any],
    speeds: tuple[float, float],
) -> PolicyDescription:
    """Describe a policy that drives a robot.

    Args:
        policy: The policy.
        trunk: Layers from the observation to z.
        law: Layers from z to actions in [-1, 1].
        scan: The manifest's part for the scan.
        speeds: Speed and turn rate that map to 1 [m/s, rad/s].
    """
    low, high = policy.limits
    region = policy.distribution
    heads = {"action": law} | ({} if region is None else {"distance": _distance(region)})
    manifest = PolicyManifest.model_validate(
        {
            "robot": "differential_drive",
            "observation": [scan, {"source": "odometry", "names": ["v", "omega"], "unit": list(speeds)}],
            "action": {"low": low.tolist(), "high": high.tolist()},
            "largest_distance": None if region is None else LARGEST_DISTANCE,
            "about": f"A Koopman policy, {policy.closed_loop_model().kind}, of {len(policy.z_ref)} observables.",
        }
    )

    def outputs(sensors: Sensors) -> dict[str, Array]:
        decision = policy.decide(sensors.ranges, sensors.scan, *sensors.speeds)
        distance = np.nan if region is None else region.relative_distance(decision.z)
        return {"action": decision.command, "distance": np.array([distance])}

    size = manifest.size
    return PolicyDescription(layers.Network(size, trunk, heads), outputs, policy.manifest, manifest, _REMARKS)


def _law(policy: LatentPolicy) -> tuple[layers.Layer, ...]:
    """Return the layers from z to actions in [-1, 1]."""
    controller = policy.controller
    end = layers.Clip(-1.0, 1.0) if controller.horizon is None else layers.Pointwise("tanh")
    return layers.Dense(-controller.K, controller.k), end


def _distance(region: LatentDistribution) -> tuple[layers.Layer, ...]:
    """Return the layers from z to the distance from training, relative to the border."""
    whitening = region.whitening / region.distance
    return layers.Dense(whitening, -whitening @ region.mean), layers.Length()


def _encoder(policy: LatentPolicy) -> Iterator[layers.Layer]:
    """Yield the layers from the observation to z.

    Raises:
        KoopmanError: The encoder has a layer that cannot be exported.
    """
    encoder = policy.controller.encoder
    yield layers.Scale(np.atleast_1d(encoder.middle), np.atleast_1d(encoder.unit))
    inner = tuple(_network(encoder))
    yield from (layers.Prepend(inner),) if encoder.inclusive else inner
    projection = policy.controller.projection
    if projection is not None:
        yield layers.Dense(projection, np.zeros(len(projection)))


def _network(encoder: Encoder) -> Iterator[layers.Layer]:
    for layer in encoder.layers:
        if isinstance(layer, Dense):
            yield layers.Dense(layer.weight, layer.bias)
            if layer.rectified:
                yield layers.Pointwise("relu")
        elif isinstance(layer, LayerNorm):
            yield layers.Normalise(layer.weight, layer.bias, float(EPSILON))
        elif isinstance(layer, Rectifier):
            yield layers.Pointwise("relu")
        else:
            raise KoopmanError(f"has a layer that cannot be exported: {type(layer).__name__}")

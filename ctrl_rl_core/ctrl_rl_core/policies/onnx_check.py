"""Compares an exported model with the policy that it was made from, on random observations."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import NamedPart, PolicyManifest
from ctrl_rl_core.policies.observation import ObservationBuilder
from ctrl_rl_core.policies.onnx_policy import open_checked
from ctrl_rl_core.policies.onnx_trial import run_model
from ctrl_rl_core.policies.policy import PolicyDescription
from ctrl_rl_core.sensing.odometry import make_odometry
from ctrl_rl_core.sensing.scan import ScanGeometry, Sensors

Array = NDArray[np.float64]

OBSERVATIONS = 1000
"""Number of random observations."""
TOLERANCE = 1e-5
"""Largest difference of a command, relative to its range, or of a probability."""
_DISTANCE_TOLERANCE = 1e-3
"""Largest difference of a distance from training, relative to the distance or to the border."""
_SCAN = ScanGeometry(720, 0.0, 2.0 * np.pi / 720, 0.05, 30.0)
_FAR = 10.0
"""Bound of drawn positions whose part has none [m]."""
_SPEEDS = (2.0, 2.0, 6.0)


def largest_difference(description: PolicyDescription, model: bytes, count: int = OBSERVATIONS, seed: int = 0) -> float:
    """Return the largest difference of a model's outputs from the policy's own.

    Commands are relative to their range; log-probabilities are compared as probabilities.

    Args:
        description: The policy.
        model: ONNX model that was made from the policy.
        count: Number of observations.
        seed: Seed of the observations.

    Raises:
        PolicyError: The model cannot be run, onnxruntime is missing, or the distance from training differs.
    """
    session = open_checked(model, description.network.size)
    generator = np.random.default_rng(seed)
    manifest, largest = description.manifest, 0.0
    if manifest is None:
        for _ in range(count):
            observation = generator.normal(size=description.network.size).astype(np.float32)
            own = description.outputs(observation)
            for name, found in zip(description.network.heads, run_model(session, observation), strict=True):
                largest = max(largest, float(np.nanmax(np.abs(_in_range(name, found[0]) - _in_range(name, own[name])))))
        return largest
    observe = ObservationBuilder(manifest)
    span = np.subtract(manifest.action.high, manifest.action.low)
    for sensors in _draw_sensors(manifest, generator, count):
        own = description.outputs(sensors)
        action, *distances = (found[0].astype(np.float64) for found in run_model(session, observe(sensors)))
        largest = max(largest, float(np.abs((manifest.action.command(action) - own["action"]) / span).max()))
        for distance in distances:
            _compare_distances(distance, own["distance"])
    return largest


def _in_range(name: str, values: Array) -> Array:
    """Return actions in [-1, 1] relative to their range, or log-probabilities as probabilities."""
    return 0.5 * values if name == "action" else np.exp(values)


def _compare_distances(found: Array, own: Array) -> None:
    difference = float(np.abs(found - own).max() / max(1.0, float(np.abs(own).max())))
    if not difference <= _DISTANCE_TOLERANCE:
        raise PolicyError(f"the model's distance from training differs by {difference:.1e}")


def _draw_sensors(manifest: PolicyManifest, generator: np.random.Generator, count: int) -> Iterator[Sensors]:
    """Yield random readings: walls near and far, odometry, pose and goal within what the policy observes."""
    low, high = np.array(manifest.action.low), np.array(manifest.action.high)
    plane = "xz" if manifest.robot == "planar_quadrotor" else "xy"
    reach = _reach(manifest)
    for _ in range(count):
        ranges = generator.uniform(0.05, 1.0, _SCAN.beams) * generator.choice((0.5, 2.0, 8.0))
        ranges[generator.random(_SCAN.beams) < 0.05] = np.inf
        if generator.random() < 0.5:  # every other reading is of walls, others are of single posts
            ranges = np.minimum(np.repeat(ranges[::60], 60), 29.0)
        velocity = generator.uniform(-1.0, 1.0, 3) * _SPEEDS * (1.0, plane == "xz", 1.0)
        poses = generator.uniform(-1.0, 1.0, (3, 3)) * (reach, reach, np.pi)
        odometry = make_odometry(poses[0], velocity, plane)
        command = generator.uniform(low, high)
        yield Sensors(ranges.astype(np.float32), _SCAN, odometry, poses[1], poses[2], command)


def _reach(manifest: PolicyManifest) -> float:
    """Return the largest position that the policy tells from others [m]."""
    places = [
        max(abs(low), abs(high))
        for part in manifest.observation
        if isinstance(part, NamedPart)
        for name, low, high in zip(part.names, part.spread("low"), part.spread("high"), strict=True)
        if name in {"x", "y", "z"}
    ]
    return float(min(max(places, default=_FAR), 100.0))

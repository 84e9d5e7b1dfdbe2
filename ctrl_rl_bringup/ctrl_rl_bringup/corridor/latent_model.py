"""The linear latent model of a recorded drive: its poles and its prediction errors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.driving import ENDED
from ctrl_rl_core.ros import seconds
from numpy.typing import NDArray

from ctrl_rl_bags import bag_info, read_messages
from ctrl_rl_bringup.runner.transport import recorded_parameters
from ctrl_rl_core import CtrlRlError
from koopman_lqr_controller import digest, find_policy, load_policy

Array = NDArray[np.float64]

_TOPIC = "/koopman_lqr_controller/latent"
_SHOWN = 4
_SAME = 1e-9


@dataclass(frozen=True)
class LatentModel:
    """The latent model of the policy that drove, and its prediction errors.

    Attributes:
        dimensions: Number of dimensions of the latent space.
        poles: Poles of the closed loop A - B K, largest first (n,); empty if the policy's file has changed.
        steps: Stamp [s], prediction error, and distance that the latent moved, which is the error of predicting no
            change (k, 3).
        farthest: Maximum distance from the latents of training, 1 at the border; NaN if the policy has no border.
        stops: Number of scans answered by a stop, by reason.
    """

    dimensions: int
    poles: NDArray[np.complex128]
    steps: Array
    farthest: float
    stops: Mapping[str, int]

    @property
    def error_over_persistence(self) -> float:
        """Root mean square of the one-step errors, relative to predicting no change; NaN without a prediction."""
        missed, moved = (float(np.sum(self.steps[:, column] ** 2)) for column in (1, 2))
        return float(np.sqrt(missed / moved)) if moved > 0.0 else float("nan")

    @property
    def spectral_radius(self) -> float:
        """Spectral radius of the closed loop; NaN if its poles are unknown."""
        return float(np.abs(self.poles[0])) if len(self.poles) else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as plain JSON values."""
        known = {
            "spectral_radius": self.spectral_radius,
            "error_over_persistence": self.error_over_persistence,
            "farthest_from_training": self.farthest,
        }
        return {
            "dimensions": self.dimensions,
            "poles": [[float(pole.real), float(pole.imag)] for pole in self.poles],
            **{name: value if np.isfinite(value) else None for name, value in known.items()},
            "predicted_steps": len(self.steps),
            "stops": dict(self.stops),
        }

    def text(self) -> tuple[str, ...]:
        """Return the figures for people."""
        poles = "poles unknown: the policy's file is not the one that drove"
        if len(self.poles):
            slowest = [pole for pole in self.poles if pole.imag >= 0.0][:_SHOWN]
            poles = f"spectral radius {self.spectral_radius:.3f}, slowest poles {', '.join(map(_pole, slowest))}"
        error = f"{self.error_over_persistence:.2f} of that of 'nothing changes', {len(self.steps)} steps"
        seen = "" if np.isnan(self.farthest) else f"at most {self.farthest:.2f} of the border's distance; "
        stops = ", ".join(f"{count} scans: {reason}" for reason, count in self.stops.items()) or "no stop"
        return (
            f"latent model        {self.dimensions} dimensions, {poles}",
            f"prediction error    {error if len(self.steps) else 'nothing was predicted'}",
            f"guards              {seen}{stops}",
        )


def read_latent_model(bag: Path) -> LatentModel | None:
    """Read it from a bag, and the poles from the policy's file; None if no Koopman controller drove.

    Raises:
        BagError: The bag cannot be read.
    """
    info = bag_info(bag)
    topic = min((name for name in info.topics if name.endswith(_TOPIC)), default="")
    if not topic:
        return None
    before = np.empty(0)
    steps, distances, dimensions = [], [], 0
    stops: Counter[str] = Counter()
    for message in read_messages(bag, [topic]):
        data = message.data
        stop = getattr(data, "stop", "")  # bags from before there were guards have none
        stops.update([stop] if stop and not stop.startswith(ENDED) else [])
        distances.append(getattr(data, "distance", np.nan))
        z = np.asarray(data.z, dtype=np.float64)
        dimensions = len(z)
        if len(data.z_predicted) == len(z) == len(before):
            steps.append((seconds(data.header.stamp), data.prediction_error, float(np.linalg.norm(z - before))))
        before = z
    known = [each for each in distances if np.isfinite(each)]
    poles = _poles(info.custom_data)
    return LatentModel(
        dimensions, poles, np.array(steps).reshape(-1, 3), max(known) if known else float("nan"), dict(stops)
    )


def _poles(custom_data: Mapping[str, str]) -> NDArray[np.complex128]:
    """Return the poles of the policy that a bag names, if its file is unchanged."""
    try:
        path = find_policy(str(recorded_parameters(custom_data, "koopman_lqr_controller").get("policy", "")))
        if digest(path) != custom_data.get("digest.policy"):
            return np.empty(0, dtype=complex)
        poles = np.linalg.eigvals(load_policy(path).loop).astype(complex)
    except CtrlRlError:
        return np.empty(0, dtype=complex)
    return poles[np.argsort(-np.abs(poles), kind="stable")]


def _pole(pole: complex) -> str:
    return f"{pole.real:.3f}" if abs(pole.imag) < _SAME else f"{pole.real:.3f}+-{abs(pole.imag):.3f}j"

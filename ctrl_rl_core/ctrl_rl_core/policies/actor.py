"""A learnt actor: a small network in NumPy, and its file.

actor = Actor.load("policy.safetensors")
command = actor.command(observation)      # the task's observation in SI units -> v, omega or T_1, T_2
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.io.checked_tensors import encode_tensors, read_tensors
from ctrl_rl_core.io.file_checks import FileError, raise_as
from ctrl_rl_core.io.schema import Anything, Schema
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import PolicyManifest

Array = NDArray[np.float32]

FORMAT = "actor-1"
_HEADER_KEY = "actor"
_VECTORS = ("middle", "unit", "low", "high")
_LAYER_NORM_EPSILON = np.float32(1e-5)  # as in torch


class _Header(Schema):
    """Header of an actor file, see `Actor`."""

    format: Literal["actor-1"]
    layers: Annotated[int, Field(ge=1, le=100)]
    activation: Literal["normalized_tanh", "normalized_relu", "tanh", "relu"]
    squashed: bool
    manifest: Anything
    interface: PolicyManifest | None = None


@dataclass(frozen=True)
class Actor:
    """A deterministic policy: a multilayer perceptron of the scaled observation.

    Attributes:
        weights: Weights of each layer (out, in).
        biases: Biases of each layer (out,).
        activation: Function after each layer but the last, "tanh" or "relu"; "normalized_tanh" and "normalized_relu"
            first normalise the layer's outputs to mean 0 and variance 1.
        squashed: Whether the last layer ends in tanh; otherwise actions are clipped to [-1, 1].
        middle: Observation that maps to network input 0, in the observation's units (n,).
        unit: Distance from `middle` that maps to network input 1 (n,).
        low: Commands of action -1 (m,).
        high: Commands of action 1 (m,).
        manifest: Provenance of the policy: task, observation names, results; plain JSON values.
        interface: Observation and commands on a robot; None in files that predate interfaces.
    """

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    activation: str
    squashed: bool
    middle: Array
    unit: Array
    low: Array
    high: Array
    manifest: Mapping[str, Any] = field(default_factory=dict)
    interface: PolicyManifest | None = None

    def scaled_action(self, scaled: ArrayLike) -> Array:
        """Return actions in [-1, 1] (..., m) for network inputs (..., n)."""
        x = np.asarray(scaled, dtype=np.float32)
        kind = self.activation.removeprefix("normalized_")
        for index, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = x @ W.T + b
            if index < len(self.weights) - 1:
                if kind != self.activation:
                    x = x - x.mean(axis=-1, keepdims=True)
                    x = x / np.sqrt((x * x).mean(axis=-1, keepdims=True) + _LAYER_NORM_EPSILON)
                x = np.tanh(x) if kind == "tanh" else np.maximum(x, 0.0)
        return np.tanh(x) if self.squashed else np.clip(x, -1.0, 1.0)

    def command(self, observation: ArrayLike) -> Array:
        """Return the command (m,) for an observation in SI units (n,)."""
        scaled = (np.asarray(observation, dtype=np.float32) - self.middle) / self.unit
        return self.low + 0.5 * (self.scaled_action(scaled) + 1.0) * (self.high - self.low)

    def save(self, path: Path | str) -> None:
        """Write the policy atomically.

        Raises:
            PolicyError: A number of the network is not finite.
        """
        tensors = {name: getattr(self, name) for name in _VECTORS}
        for index, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            tensors |= {f"weight_{index}": W, f"bias_{index}": b}
        header = {
            "format": FORMAT,
            "layers": len(self.weights),
            "activation": self.activation,
            "squashed": self.squashed,
            "manifest": dict(self.manifest),
        }
        if self.interface is not None:
            header["interface"] = self.interface.model_dump(exclude_defaults=True)
        plain = {name: np.ascontiguousarray(tensor, dtype=np.float32) for name, tensor in tensors.items()}
        if not all(np.isfinite(tensor).all() for tensor in plain.values()):
            raise PolicyError("the network's numbers are not finite: its training has diverged")
        atomic_write(Path(path), encode_tensors(plain, _HEADER_KEY, header))

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a policy.

        Raises:
            PolicyError: The file is missing or is not an actor; the message names it.
        """
        with raise_as(PolicyError, path, "learn it again"):
            header, tensors, _ = read_tensors(path, _HEADER_KEY, types=("F32",))
            told = _Header.model_validate(header)
            layers = range(told.layers)
            wanted = {*_VECTORS, *(f"{kind}_{index}" for kind in ("weight", "bias") for index in layers)}
            if set(tensors) != wanted:
                raise FileError("has other tensors than its layers need")
            actor = cls(
                weights=tuple(tensors[f"weight_{index}"] for index in layers),
                biases=tuple(tensors[f"bias_{index}"] for index in layers),
                activation=told.activation,
                squashed=told.squashed,
                manifest=told.manifest,
                interface=told.interface,
                **{name: tensors[name] for name in _VECTORS},
            )
            actor.check()
        return actor

    def check(self) -> None:
        """Check that the tensors have consistent shapes.

        Raises:
            PolicyError: The shapes are inconsistent.
        """
        width, commands = self.middle.shape, self.low.shape
        fits = len(width) == len(commands) == 1 and self.unit.shape == width and self.high.shape == commands
        for W, b in zip(self.weights, self.biases, strict=True):
            fits = fits and W.ndim == 2 and W.shape[1:] == width and b.shape == W.shape[:1]
            width = b.shape
        if not fits or width != commands or not (self.unit > 0.0).all():
            raise PolicyError("its tensors do not fit each other")
        if self.interface is not None and (self.interface.size, 2) != (len(self.middle), len(self.low)):
            raise PolicyError(
                f"its network takes {len(self.middle)} numbers and gives {len(self.low)}, its interface has "
                f"{self.interface.size} and 2"
            )

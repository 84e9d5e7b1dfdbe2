"""A learnt policy, deployed: a small network in NumPy, and its file.

actor = Actor.load("policy.safetensors")
command = actor.command(observation)      # what the task's sensors say, in SI units -> v, omega or T_1, T_2
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from ctrl_rl_core.io.checked_tensors import encode_tensors, read_tensors
from ctrl_rl_core.io.file_checks import FileError, raise_as
from ctrl_rl_core.io.schema import Anything, Schema
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from ctrl_rl_core import atomic_write
from ctrl_rl_training.errors import TrainingError

Array = NDArray[np.float32]

FORMAT = "actor-1"
_HEADER_KEY = "actor"


class _Header(Schema):
    """What a policy says of itself, see `Actor`."""

    format: Literal["actor-1"]
    layers: Annotated[int, Field(ge=1, le=100)]
    activation: Literal["normalized_tanh", "normalized_relu"]
    squashed: bool
    manifest: Anything


_LAYER_NORM_EPSILON = np.float32(1e-5)  # torch's


@dataclass(frozen=True)
class Actor:
    """A deterministic policy: a multilayer perceptron of the scaled observation.

    Attributes:
        weights: Weights of each layer (out, in).
        biases: Biases of each layer (out,).
        activation: Function after each layer but the last, "normalized_tanh" or "normalized_relu": the outputs are
            brought to mean 0 and variance 1 over its units, then go through it.
        squashed: whether the last layer ends in tanh; else actions are cut at -1 and 1.
        middle: Observation that becomes 0 in the network's input, in the observation's units (n,).
        unit: Distance above the middle that becomes 1 (n,).
        low: least commands, those of action -1 (m,).
        high: largest commands, those of action 1 (m,).
        manifest: anything else worth keeping: task, names of the observation, figures.
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

    def scaled_action(self, scaled: ArrayLike) -> Array:
        """Return the action in [-1, 1] (m,) for an observation in the network's own units (n,)."""
        x = np.asarray(scaled, dtype=np.float32)
        for index, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = W @ x + b
            if index < len(self.weights) - 1:
                x = (x - x.mean()) / np.sqrt(x.var() + _LAYER_NORM_EPSILON)
                x = np.tanh(x) if self.activation == "normalized_tanh" else np.maximum(x, 0.0)
        return np.tanh(x) if self.squashed else np.clip(x, -1.0, 1.0)

    def command(self, observation: ArrayLike) -> Array:
        """Return the command (m,) for an observation in SI units (n,)."""
        scaled = (np.asarray(observation, dtype=np.float32) - self.middle) / self.unit
        return self.low + 0.5 * (self.scaled_action(scaled) + 1.0) * (self.high - self.low)

    def save(self, path: Path) -> None:
        """Write the policy; the file is there whole or not at all."""
        tensors = {name: getattr(self, name) for name in _VECTORS}
        for index, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            tensors |= {f"weight_{index}": W, f"bias_{index}": b}
        manifest = {
            "format": FORMAT,
            "layers": len(self.weights),
            "activation": self.activation,
            "squashed": self.squashed,
            "manifest": dict(self.manifest),
        }
        plain = {name: np.ascontiguousarray(tensor, dtype=np.float32) for name, tensor in tensors.items()}
        atomic_write(path, encode_tensors(plain, _HEADER_KEY, manifest))

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a policy.

        Raises:
            TrainingError: the file is missing or is not such a policy; the message names it.
        """
        with raise_as(TrainingError, path, "learn it again"):
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
                **{name: tensors[name] for name in _VECTORS},
            )
            actor.check()
        return actor

    def check(self) -> None:
        """Refuse tensors that do not fit each other.

        Raises:
            TrainingError: they do not.
        """
        width, commands = self.middle.shape, self.low.shape
        fits = len(width) == len(commands) == 1 and self.unit.shape == width and self.high.shape == commands
        for W, b in zip(self.weights, self.biases, strict=True):
            fits = fits and W.ndim == 2 and W.shape[1:] == width and b.shape == W.shape[:1]
            width = b.shape
        if not fits or width != commands or not (self.unit > 0.0).all():
            raise TrainingError("its tensors do not fit each other")


_VECTORS = ("middle", "unit", "low", "high")

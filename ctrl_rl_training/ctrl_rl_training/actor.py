"""A learnt policy, deployed: a small network in NumPy, and its file.

actor = Actor.load("policy.safetensors")
command = actor.command(observation)      # what the task's sensors say, in SI units -> v, omega or T_1, T_2
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from ctrl_rl_core.whole_file import write_whole
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ctrl_rl_training.errors import TrainingError

Array = NDArray[np.float32]

FORMAT = "actor-1"
_HEADER_KEY = "actor"
_LAYER_NORM_EPSILON = np.float32(1e-5)  # torch's


@dataclass(frozen=True)
class Actor:
    """A deterministic policy: a multilayer perceptron of the scaled observation.

    Attributes:
        weights: of each layer (out, in).
        biases: of each layer (out,).
        activation: after each layer but the last, "normalized_tanh" or "normalized_relu": the layer's outputs are
            brought to mean 0 and variance 1 over its units, then go through it.
        squashed: whether the last layer ends in tanh; else actions are cut at -1 and 1.
        middle: what becomes 0 in the network's input, in the observation's units (n,).
        unit: what becomes 1 above it (n,).
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
        content = save(
            {name: np.ascontiguousarray(tensor, dtype=np.float32) for name, tensor in tensors.items()},
            metadata={_HEADER_KEY: json.dumps(manifest, sort_keys=True)},
        )
        write_whole(path, content)

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a policy.

        Raises:
            TrainingError: the file is missing or is not such a policy; the message names it.
        """
        try:
            with safe_open(path, framework="np") as file:
                header = json.loads((file.metadata() or {}).get(_HEADER_KEY, "{}"))
                if header.get("format") != FORMAT:
                    raise TrainingError(f"{path}: is not a policy of format {FORMAT}: learn it again")
                layers = range(header["layers"])
                return cls(
                    weights=tuple(file.get_tensor(f"weight_{index}") for index in layers),
                    biases=tuple(file.get_tensor(f"bias_{index}") for index in layers),
                    activation=header["activation"],
                    squashed=header["squashed"],
                    manifest=header["manifest"],
                    **{name: file.get_tensor(name) for name in _VECTORS},
                )
        except (OSError, SafetensorError, ValueError, KeyError) as error:
            raise TrainingError(f"{path}: cannot be read as a policy ({error})") from None


_VECTORS = ("middle", "unit", "low", "high")

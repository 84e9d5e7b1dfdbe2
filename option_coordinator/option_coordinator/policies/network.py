"""The networks of the policies in NumPy, by the names that torch gives their tensors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from option_coordinator.policies.joint_policy import JointPolicy

Array = NDArray[np.floating]
Tensors = Mapping[str, Array]
_EPSILON = 1e-5  # torch's


def linear(tensors: Tensors, name: str, x: Array) -> Array:
    """Return W x + b for x (..., in)."""
    return np.asarray(x @ tensors[f"{name}.weight"].T + tensors[f"{name}.bias"])


def layer_norm(tensors: Tensors, name: str, x: Array) -> Array:
    """Return x (..., n) brought to mean 0 and variance 1 over its components, then scaled and shifted."""
    size = x.shape[-1]  # sums, as means take thrice as long where there are few numbers
    centred = x - x.sum(axis=-1, keepdims=True) / size
    scale = np.sqrt((centred * centred).sum(axis=-1, keepdims=True) / size + _EPSILON)
    return np.asarray(centred / scale * tensors[f"{name}.weight"] + tensors[f"{name}.bias"])


def features(tensors: Tensors, x: Array) -> Array:
    """Return MAPPO's features (..., hidden) of an observation (..., n): norm, then twice linear, ReLU, norm."""
    x = layer_norm(tensors, "trunk.norm_0", x)
    for layer in (1, 2):
        x = layer_norm(tensors, f"trunk.norm_{layer}", np.maximum(linear(tensors, f"trunk.linear_{layer}", x), 0.0))
    return x


def part(tensors: Tensors, prefix: str) -> dict[str, Array]:
    """Return the tensors whose names begin with a prefix, without it."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


class NetworkPolicy(JointPolicy):
    """A joint policy with MAPPO's trunk, which observes what the trunk's first norm takes.

    Args:
        tensors: Tensors of the trunk and of the head, by the names that the subclass gives.
        counts: Number of options of each agent.
    """

    def __init__(self, tensors: Tensors, counts: tuple[int, ...]) -> None:
        self.counts = counts
        self.observation_size = tensors["trunk.norm_0.weight"].shape[0]
        self._tensors = tensors

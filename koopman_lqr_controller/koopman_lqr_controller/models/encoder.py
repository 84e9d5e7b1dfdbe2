"""The embedding psi(x) = z of thesis 4.2.2, as run on the robot: a small network, NumPy only."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError

Weights = NDArray[np.float32]

_MOST_PRODUCTS = 10_000_000_000
EPSILON = np.float32(1e-5)
"""Term added to the variance in `LayerNorm`."""


class Layer(Protocol):
    """One layer of the network, for inputs with any number of leading dimensions."""

    def __call__(self, x: Weights) -> Weights:
        """Return the outputs."""


@dataclass(frozen=True)
class Dense:
    """W x + b, followed by a ReLU if `rectified`.

    Attributes:
        weight: Weights of the layer (out, in).
        bias: Bias of each output (out,).
        rectified: Whether to apply a ReLU.
    """

    NAME: ClassVar[str] = "dense"
    weight: Weights
    bias: Weights
    rectified: bool

    def __call__(self, x: Weights) -> Weights:
        """Return the outputs (..., out) for inputs (..., in)."""
        y = x.dot(self.weight.T)  # a third faster than @ for a single vector
        y += self.bias
        return np.maximum(y, 0.0, out=y) if self.rectified else y


@dataclass(frozen=True)
class Convolution:
    """A convolution without padding, followed by a ReLU; outputs keep the image layout.

    Attributes:
        weight: Weights of the filters (out, in, k, k).
        bias: Bias of each output (out,).
        stride: Stride along both axes.
    """

    NAME: ClassVar[str] = "convolution"
    weight: Weights
    bias: Weights
    stride: int

    def __call__(self, x: Weights) -> Weights:
        """Return the outputs (..., out, rows, columns) for images (..., in, height, width)."""
        k = self.weight.shape[-1]
        windows = sliding_window_view(x, (k, k), axis=(-2, -1))[..., :: self.stride, :: self.stride, :, :]
        y = np.tensordot(np.moveaxis(windows, -5, -3), self.weight, axes=((-3, -2, -1), (1, 2, 3))) + self.bias
        return np.ascontiguousarray(np.moveaxis(np.maximum(y, np.float32(0.0)), -1, -3))


@dataclass(frozen=True)
class CentreCrop:
    """Crops an image to its centre.

    Attributes:
        size: Number of remaining rows and columns.
    """

    NAME: ClassVar[str] = "centre_crop"
    size: int

    def __call__(self, x: Weights) -> Weights:
        """Return the centre (..., size, size) of images (..., height, width)."""
        top, left = ((length - self.size) // 2 for length in x.shape[-2:])
        return x[..., top : top + self.size, left : left + self.size]


@dataclass(frozen=True)
class Flatten:
    """Flattens images (channels, rows, columns) to vectors."""

    NAME: ClassVar[str] = "flatten"

    def __call__(self, x: Weights) -> Weights:
        """Return (..., channels * rows * columns)."""
        return x.reshape(*x.shape[:-3], -1)


@dataclass(frozen=True)
class Rectifier:
    """A ReLU for a layer without its own."""

    NAME: ClassVar[str] = "rectifier"

    def __call__(self, x: Weights) -> Weights:
        """Return the outputs, in the input's shape."""
        return np.maximum(x, np.float32(0.0))


@dataclass(frozen=True)
class LayerNorm:
    """Normalises a vector to mean 0 and variance 1 over its entries, then scales and shifts each entry.

    Attributes:
        weight: Scale of each entry (n,).
        bias: Shift of each entry (n,).
    """

    NAME: ClassVar[str] = "layer_norm"
    weight: Weights
    bias: Weights

    def __call__(self, x: Weights) -> Weights:
        """Return the outputs (..., n)."""
        n = np.float32(x.shape[-1])
        total: Weights = np.add.reduce(x, axis=-1, keepdims=True)  # same as `mean`, in half the time
        y = x - total / n
        variance = np.einsum("...i,...i->...", y, y)[..., None] / n
        y /= np.sqrt(variance + EPSILON)
        y *= self.weight
        y += self.bias
        return y


_KINDS: tuple[Any, ...] = (Dense, Convolution, CentreCrop, Flatten, Rectifier, LayerNorm)


@dataclass(frozen=True)
class Encoder:
    """psi(x): normalisation, then one layer after the other.

    Attributes:
        layers: Layers in order; the last gives z.
        shape: Shape of one observation.
        middle: Value of the observation that maps to 0, in its units; broadcasts to `shape`.
        unit: Distance from `middle` that maps to 1.
        inclusive: Whether z starts with the normalised (vector) observation, followed by the layers' outputs.
    """

    layers: Sequence[Layer]
    shape: tuple[int, ...]
    middle: Weights
    unit: Weights
    inclusive: bool = False

    def __post_init__(self) -> None:
        arrays = [self.middle, self.unit]
        arrays += [it for layer in self.layers for it in vars(layer).values() if isinstance(it, np.ndarray)]
        if not all(np.isfinite(array).all() for array in arrays):
            raise KoopmanError("the encoder holds values that are not finite")
        if not (self.unit > 0.0).all():
            raise KoopmanError("the encoder's unit must be positive")

    def __call__(self, x: ArrayLike) -> Array:
        """Return z (n,) or (N, n) for one observation (*shape) or many (N, *shape).

        Raises:
            KoopmanError: The observation has the wrong shape.
        """
        given = np.asarray(x, dtype=np.float32)
        if given.shape[-len(self.shape) :] != self.shape:
            raise KoopmanError(f"observation has shape {given.shape}, the encoder wants {self.shape}")
        normalised: Weights = (given - self.middle) / self.unit
        y = normalised
        for layer in self.layers:
            y = layer(y)
        if self.inclusive:
            y = np.concatenate((normalised, y), axis=-1)
        return y.astype(np.float64)

    def followed_by(self, layers: Sequence[Layer]) -> Encoder:
        """Return the encoder with additional layers."""
        return replace(self, layers=(*self.layers, *layers))

    def describe(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return JSON and tensors from which `build` recreates the encoder."""
        layers: list[dict[str, Any]] = []
        tensors: dict[str, NDArray[Any]] = {"encoder.middle": self.middle, "encoder.unit": self.unit}
        for index, layer in enumerate(self.layers):
            fields = vars(layer)
            tensors |= {f"encoder.{index}.{name}": it for name, it in fields.items() if isinstance(it, np.ndarray)}
            plain = {name: it for name, it in fields.items() if not isinstance(it, np.ndarray)}
            layers.append({"kind": type(layer).__dict__["NAME"], **plain})
        description: dict[str, Any] = {"shape": list(self.shape), "layers": layers}
        return {**description, "inclusive": True} if self.inclusive else description, tensors

    @classmethod
    def build(cls, description: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> Encoder:
        """Recreate the encoder from the output of `describe`.

        Raises:
            KoopmanError: The description is invalid; the message gives the location.
        """
        kinds = {kind.NAME: kind for kind in _KINDS}
        layers = []
        for index, given in enumerate(description["layers"]):
            rest = dict(given)
            kind, prefix = kinds.get(rest.pop("kind", "")), f"encoder.{index}."
            if kind is None:
                raise KoopmanError(f"encoder layer {index} is of an unknown kind: must be one of {', '.join(kinds)}")
            arrays = {
                name.removeprefix(prefix): np.ascontiguousarray(array, dtype=np.float32)
                for name, array in tensors.items()
                if name.startswith(prefix)
            }
            lacking = {"weight", "bias"} & {field.name for field in fields(kind)} ^ set(arrays)
            if lacking or any(array.ndim == 0 for array in arrays.values()):
                raise KoopmanError(f"encoder layer {index} ({kind.NAME}) has other tensors than it needs")
            if kind is Convolution and arrays["weight"].size * math.prod(description["shape"][-2:]) > _MOST_PRODUCTS:
                raise KoopmanError(f"encoder layer {index} ({kind.NAME}) is too large to run in every step")
            layers.append(kind(**arrays, **rest))
        shape = tuple(int(size) for size in description["shape"])
        middle, unit = (tensors[f"encoder.{name}"].astype(np.float32) for name in ("middle", "unit"))
        return cls(tuple(layers), shape, middle, unit, bool(description.get("inclusive", False)))

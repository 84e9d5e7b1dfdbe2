"""A policy's computation in neutral form, layer by layer, from which other formats are written.

All layers take and return arrays with the batch as first axis. They only describe; `onnx_writer` gives them operators.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Scale:
    """(x - middle) / unit.

    Attributes:
        middle: Input that maps to 0 (n,) or (1,).
        unit: Distance from `middle` that maps to 1 (n,) or (1,).
    """

    middle: Array
    unit: Array


@dataclass(frozen=True, eq=False)
class Dense:
    """W x + b.

    Attributes:
        weight: W (out, in).
        bias: b (out,).
    """

    weight: Array
    bias: Array


@dataclass(frozen=True)
class Pointwise:
    """A function of each value."""

    function: Literal["tanh", "relu"]


@dataclass(frozen=True)
class Clip:
    """Limits each value to `low` .. `high`."""

    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Normalise:
    """Normalises the values (n,) to mean 0 and variance 1, then scales and shifts each.

    Attributes:
        weight: Scale of each value (n,).
        bias: Shift of each value (n,).
        epsilon: Term added to the variance.
    """

    weight: Array
    bias: Array
    epsilon: float = 1e-5


@dataclass(frozen=True)
class Nearness:
    """Replaces the first `count` values, distances [m], by `near` over distance; keeps the others."""

    count: int
    near: float


@dataclass(frozen=True)
class Length:
    """The Euclidean norm of the values (1,)."""


@dataclass(frozen=True)
class Prepend:
    """The input, followed by the outputs of layers applied to the input."""

    layers: tuple[Layer, ...]


@dataclass(frozen=True)
class Table:
    """Arranges the values as a table of this shape, batch apart."""

    shape: tuple[int, ...]


@dataclass(frozen=True)
class LogSoftmax:
    """Logarithms of probabilities that sum to 1 along an axis; axis 0 is the batch."""

    axis: int


Layer = Scale | Dense | Pointwise | Clip | Normalise | Nearness | Length | Prepend | Table | LogSoftmax


class Network(NamedTuple):
    """A network with named outputs.

    Attributes:
        size: Size of the observation.
        trunk: Layers that all outputs share.
        heads: Further layers of each output, by name, in order; those of a driving policy begin with "action".
    """

    size: int
    trunk: tuple[Layer, ...]
    heads: Mapping[str, tuple[Layer, ...]]

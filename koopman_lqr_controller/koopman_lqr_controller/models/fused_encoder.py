"""The embedding of one observation in as few matrix products as possible, for the controller on the robot."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.encoder import EPSILON, Dense, Encoder, LayerNorm, Rectifier, Weights

_ZERO = np.array(0.0, np.float32)  # NumPy takes a Python number in twice the time


class _Step(NamedTuple):
    """A matrix (in + 1, out + 1) for vectors whose last entry is 1, and what is nonlinear after it."""

    matrix: Weights
    rectified: bool = False
    normalised: bool = False


class FusedEncoder:
    """C psi(x) for one x: what is linear between two nonlinear steps, biases, norms and C too, is one matrix.

    It differs from the encoder by rounding alone.

    Args:
        encoder: psi, of dense layers and norms.
        projection: C (n, encoder's n); None for the identity.

    Raises:
        KoopmanError: the encoder has something else in it.
    """

    def __init__(self, encoder: Encoder, projection: Array | None = None) -> None:
        if len(encoder.shape) != 1 or encoder.inclusive:
            raise KoopmanError("only an encoder of vectors that gives its last layer's outputs can be fused")
        self._size = encoder.shape[0]
        unit = np.broadcast_to(np.asarray(encoder.unit, float), self._size)
        linear = _affine(np.diag(1.0 / unit), -encoder.middle / unit)
        self._steps: list[_Step] = []
        for layer in encoder.layers:
            if isinstance(layer, Dense):
                linear = _affine(layer.weight, layer.bias) @ linear
            elif isinstance(layer, LayerNorm):
                n = len(layer.weight)
                self._steps.append(_Step(_float32(_affine(np.eye(n) - 1.0 / n, np.zeros(n)) @ linear), normalised=True))
                linear = _affine(np.diag(layer.weight), layer.bias)
            elif not isinstance(layer, Rectifier):
                raise KoopmanError(
                    f"only an encoder of dense layers and norms can be fused, not one with {type(layer).__name__}"
                )
            if isinstance(layer, Rectifier) or (isinstance(layer, Dense) and layer.rectified):
                self._steps.append(_Step(_float32(linear), rectified=True))
                linear = np.eye(len(linear))
        if projection is not None:
            linear = _affine(projection, np.zeros(len(projection))) @ linear
        self._last = _float32(linear[:-1])

    def __call__(self, x: ArrayLike) -> Array:
        """Return z (n,) for one observation (its size,)."""
        y = np.empty(self._size + 1, np.float32)
        y[:-1], y[-1] = x, 1.0
        for matrix, rectified, normalised in self._steps:
            y = y.dot(matrix)
            if rectified:
                np.maximum(y, _ZERO, out=y)
            if normalised:
                values = y[:-1]
                values *= 1.0 / math.sqrt(values.dot(values) / len(values) + EPSILON)
        return y.dot(self._last).astype(np.float64)


def _affine(weight: ArrayLike, bias: ArrayLike) -> Array:
    """Return the matrix (out + 1, in + 1) of W x + b."""
    W, b = np.asarray(weight, float), np.asarray(bias, float)
    out = np.zeros((W.shape[0] + 1, W.shape[1] + 1))
    out[:-1, :-1], out[:-1, -1], out[-1, -1] = W, b, 1.0
    return out


def _float32(matrix: Array) -> Weights:
    """Return the transpose, rows in order: so a vector times it takes the least time."""
    return np.ascontiguousarray(matrix.T, np.float32)

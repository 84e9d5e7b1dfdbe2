"""Arrays of models and policies: their type and validation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koopman_lqr_controller.errors import KoopmanError

Array = NDArray[np.float64]
_LARGEST = 1e100


def real_array(name: str, values: ArrayLike) -> Array:
    """Convert values to a float64 array, without copying if they are one.

    Raises:
        KoopmanError: The values are not real numbers, e.g. complex, text or rows of unequal length.
    """
    try:
        array = np.asarray(values)
    except ValueError:
        raise KoopmanError(f"{name} has rows of unequal length: give an array of numbers") from None
    if array.dtype.kind not in "biuf":
        raise KoopmanError(f"{name} holds {array.dtype} values: give real numbers")
    return np.asarray(array, dtype=np.float64)


def check_size(name: str, array: Array) -> None:
    """Raise if squares or products of numbers would overflow.

    Raises:
        KoopmanError: Names the array.
    """
    largest = float(np.abs(array).max(initial=0.0))
    if largest > _LARGEST or 0.0 < largest < 1.0 / _LARGEST:
        raise KoopmanError(f"{name} holds values up to {largest:.1e}: give it in other units")


def check_arrays(shapes: Mapping[str, tuple[Array, tuple[int, ...]]], reason: str) -> None:
    """Raise if arrays have the wrong shape or non-finite values.

    Args:
        shapes: Arrays and their required shapes, by name.
        reason: Text that ends the message about a shape, e.g. "for 19 observables".

    Raises:
        KoopmanError: Names the array.
    """
    for name, (array, shape) in shapes.items():
        if array.shape != shape:
            raise KoopmanError(f"{name} has shape {array.shape}, must have {shape} {reason}")
        if not np.isfinite(array).all():
            raise KoopmanError(f"{name} holds values that are not finite")

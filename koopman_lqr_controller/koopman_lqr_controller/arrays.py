"""Arrays of models and policies: their type, and the checks that a file's or a caller's must pass."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koopman_lqr_controller.errors import KoopmanError

Array = NDArray[np.float64]
_LARGEST = 1e100


def real_array(name: str, values: ArrayLike) -> Array:
    """Return values as an array of float64; it is the same one where it is that already.

    Raises:
        KoopmanError: the values are not real numbers, e.g. complex, text or rows of unequal length.
    """
    try:
        array = np.asarray(values)
    except ValueError:
        raise KoopmanError(f"{name} has rows of unequal length: give an array of numbers") from None
    if array.dtype.kind not in "biuf":
        raise KoopmanError(f"{name} holds {array.dtype} values: give real numbers")
    return np.asarray(array, dtype=np.float64)


def check_size(name: str, array: Array) -> None:
    """Refuse numbers whose squares or products would leave the range of floats.

    Raises:
        KoopmanError: names the array.
    """
    largest = float(np.abs(array).max(initial=0.0))
    if largest > _LARGEST or 0.0 < largest < 1.0 / _LARGEST:
        raise KoopmanError(f"{name} holds values up to {largest:.1e}: give it in other units")


def check_arrays(shapes: Mapping[str, tuple[Array, tuple[int, ...]]], reason: str) -> None:
    """Refuse arrays of another shape, and values that are not finite.

    Args:
        shapes: Arrays and the shapes that they must have, by name.
        reason: Words that end the message about a shape, e.g. "for 19 observables".

    Raises:
        KoopmanError: names the array.
    """
    for name, (array, shape) in shapes.items():
        if array.shape != shape:
            raise KoopmanError(f"{name} has shape {array.shape}, must have {shape} {reason}")
        if not np.isfinite(array).all():
            raise KoopmanError(f"{name} holds values that are not finite")

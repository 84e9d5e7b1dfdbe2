"""Arrays of models and policies: their type, and the checks that a file's must pass."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.errors import KoopmanError

Array = NDArray[np.float64]


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

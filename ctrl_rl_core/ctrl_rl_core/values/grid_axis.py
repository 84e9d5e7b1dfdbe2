"""One axis of a value grid."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.errors import CtrlRlError


class GridError(CtrlRlError):
    """A value grid, its file or a query is invalid; the message names the file or the field."""


@dataclass(frozen=True)
class Axis:
    """Evenly spaced nodes of one state component.

    Nodes are lower + i * spacing, i = 0 .. count - 1. The last node is `upper`, except on a periodic axis, where
    `upper` coincides with `lower` and is not stored.

    Raises:
        GridError: Bounds are not finite or not in order, or there are fewer than two nodes.
    """

    name: str
    unit: str
    lower: float
    upper: float
    count: int
    periodic: bool = False

    def __post_init__(self) -> None:
        if not self.name:
            raise GridError("an axis has no name")
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower < self.upper):
            raise GridError(
                f"axis '{self.name}': bounds are [{self.lower:g}, {self.upper:g}]; give finite lower < upper"
            )
        if self.count < 2:
            raise GridError(f"axis '{self.name}' has {self.count} nodes; give at least 2")

    @property
    def spacing(self) -> float:
        """Spacing of the nodes [unit]."""
        return (self.upper - self.lower) / (self.count if self.periodic else self.count - 1)

    @property
    def nodes(self) -> NDArray[np.float64]:
        """Coordinates of the nodes [unit], shape (count,)."""
        return np.linspace(self.lower, self.upper, self.count, endpoint=not self.periodic)

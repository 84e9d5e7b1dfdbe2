"""What a value function is to those that use one: rewards, baselines, the nodes that serve it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.value_grid import ValueGrid


class ValueFunction(Protocol):
    """A function of the state: one value grid, or several joined (a `ValueGrid` is one as well)."""

    @property
    def kind(self) -> str:
        """What it is: "time_to_reach" or "oc_value"."""

    @property
    def task(self) -> str:
        """Name of the task that it belongs to."""

    @property
    def task_digest(self) -> str:
        """SHA-256 of that task."""

    @property
    def digest(self) -> str:
        """SHA-256 of its file."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Components of the state, in order."""

    @property
    def grids(self) -> tuple[ValueGrid, ...]:
        """The grids that it consists of."""

    def value(self, states: ArrayLike) -> NDArray[np.float64]:
        """Values (...) at states (..., n): NaN outside the domain, +inf where the goal cannot be reached."""

    def value_and_gradient(self, states: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Values (...) and gradients (..., n) at states (..., n)."""

    def value_and_gradient_at(self, state: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Value and gradient (n,) at one state (n,), quickly."""

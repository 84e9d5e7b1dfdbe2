"""Protocol of value functions, for rewards, baselines and the nodes that serve them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.tasks.task import NavigationTask, task_digest
from ctrl_rl_core.values.grid_axis import Axis
from ctrl_rl_core.values.value_grid import ValueGrid

ROWS = 8192
"""States of a large batch evaluated at a time; a network layer of 64 units then takes 4 MB."""


class ValueFunctionError(CtrlRlError):
    """A value function does not fit the task or the purpose."""


class ValueFunction(Protocol):
    """A function of the state: one value grid, or several combined (`ValueGrid` also satisfies this protocol)."""

    @property
    def kind(self) -> str:
        """Kind of the values, one of `value_grid.KIND_UNITS`."""

    @property
    def task(self) -> str:
        """Name of the task that the function belongs to."""

    @property
    def task_digest(self) -> str:
        """SHA-256 of that task."""

    @property
    def digest(self) -> str:
        """SHA-256 of the function's file."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Components of the state, in order."""

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes of the state components, in order."""

    @property
    def grids(self) -> tuple[ValueGrid, ...]:
        """Grids of the function."""

    def value(self, states: ArrayLike) -> NDArray[np.float64]:
        """Return the values (...) at states (..., n): NaN outside the domain, +inf where the goal is unreachable."""

    def value_and_gradient(self, states: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Values (...) and gradients (..., n) at states (..., n)."""

    def value_and_gradient_at(self, state: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return value and gradient (n,) at one state (n,), quickly."""


def batches(count: int) -> Iterator[slice]:
    """Yield slices of a batch of `count` states, `ROWS` states in each and the rest in the last."""
    for begin in range(0, count, ROWS):
        yield slice(begin, min(begin + ROWS, count))


def check_function(function: ValueFunction, task: NavigationTask, kind: str) -> bool:
    """Return whether a function was made for this exact version of its task.

    Raises:
        ValueFunctionError: The function is of another kind, task or state.
    """
    names = task.system.build().state_names
    if function.kind != kind:
        raise ValueFunctionError(f"the value function holds '{function.kind}': '{kind}' is needed here")
    if function.task != task.name:
        raise ValueFunctionError(f"the value function belongs to task '{function.task}', not '{task.name}'")
    if function.state_names != names:
        raise ValueFunctionError(
            f"the value function's states are {', '.join(function.state_names)}; those of task '{task.name}' are "
            + ", ".join(names)
        )
    return function.task_digest == task_digest(task)

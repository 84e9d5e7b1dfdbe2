"""The plane of positions through a value function's domain, over which slices are served and drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.tasks.regions import position_indices
from ctrl_rl_core.values.grid_axis import Axis
from ctrl_rl_core.values.value_function import ValueFunction, ValueFunctionError


@dataclass(frozen=True)
class Plane:
    """The x-y or x-z plane.

    Attributes:
        names: Names of all states, in the system's order.
        first: Horizontal axis.
        second: Vertical axis.
    """

    names: tuple[str, ...]
    first: Axis
    second: Axis

    @property
    def others(self) -> tuple[str, ...]:
        """Names of the components fixed in a slice."""
        return tuple(name for name in self.names if name not in (self.first.name, self.second.name))

    def states(
        self, first: NDArray[np.float64], second: NDArray[np.float64], at: Mapping[str, float]
    ) -> NDArray[np.float64]:
        """Return the states (len(second), len(first), n) over the plane.

        Args:
            first: Positions along the first axis [m].
            second: Positions along the second axis [m].
            at: Values of the other components [their unit]; 0 by default.

        Raises:
            ValueFunctionError: `at` names an unknown component.
        """
        for name in at:
            if name not in self.others:
                raise ValueFunctionError(
                    f"'{name}' cannot be fixed: besides the position there are {', '.join(self.others) or 'none'}"
                )
        out = np.zeros((len(second), len(first), len(self.names)))
        for name, value in at.items():
            out[..., self.names.index(name)] = value
        out[..., self.names.index(self.first.name)] = first
        out[..., self.names.index(self.second.name)] = second[:, None]
        return out


def plane_of(function: ValueFunction) -> Plane:
    """Return the plane of a function's positions.

    Raises:
        ValueFunctionError: The state does not have two positions.
    """
    names = function.state_names
    indices = position_indices(names)
    if len(indices) < 2:
        raise ValueFunctionError(f"the states {', '.join(names)} have no plane of positions to show")
    return Plane(names, *(function.axes[index] for index in indices))

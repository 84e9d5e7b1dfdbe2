"""Limits of the state: the ends of the grid, or the system's own bounds if these are tighter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, System
from ttr_reward_node.errors import TimeToReachError

_SAME = 1e-9  # fraction of an axis's length: a bound closer to the axis's end counts as that end


def state_limits(system: System, axes: Sequence[Axis]) -> NDArray[np.float64]:
    """Return the range (2, n) within which each state must stay: lower and upper limit, in the state's unit.

    These are the grid's ends, tightened by the state's own bounds; -inf and inf along a periodic axis. The bounds of a
    periodic state define its period and are no limits.
    """
    limits = np.empty((2, len(axes)))
    for k, (axis, state) in enumerate(zip(axes, system.states, strict=True)):
        low, high = axis.lower, axis.upper
        if axis.periodic:
            low, high = -np.inf, np.inf
        elif not state.periodic:
            slack = _SAME * (axis.upper - axis.lower)
            low = state.lower if state.lower > low + slack else low
            high = state.upper if state.upper < high - slack else high
        limits[:, k] = low, high
    limits.flags.writeable = False
    return limits


def tighter_limits(system: System, axes: Sequence[Axis]) -> dict[str, tuple[float, float]]:
    """Return, by state name, the limits of states whose bounds are tighter than their axes."""
    limits = state_limits(system, axes)
    return {
        axis.name: (float(low), float(high))
        for axis, low, high in zip(axes, *limits, strict=True)
        if not axis.periodic and (low > axis.lower or high < axis.upper)
    }


def check_grid_within_limits(system: System, axes: Sequence[Axis], method: str) -> None:
    """Check that the grid stays within the state's bounds, for a method whose only limits are the ends of the grid.

    Raises:
        TimeToReachError: An axis extends beyond the bounds; it is named.
    """
    for name, (low, high) in tighter_limits(system, axes).items():
        raise TimeToReachError(
            f"{system.name}: '{name}' stays in [{low:g}, {high:g}], but its axis goes beyond: let the axis end there, "
            f"because {method} knows no limits but the grid's ends"
        )

"""Safety game on a grid: the system, the axes, and the sets from which both players choose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, System
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.dependence import AFFINE, check_game, dependences
from ttr_reward_node.problems.equation_checks import check_disturbances, check_equations
from ttr_reward_node.problems.limits import check_grid_within_limits
from ttr_reward_node.problems.problem_checks import check_axes, check_system

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SafetyGame:
    """x' = f(x, u, d): the control u maximises the margin, the disturbance d minimises it.

    By default the control is a vertex of its box, which suffices if f is affine in it, as in all models of
    `ctrl_rl_core.systems`: the best control is then bang-bang. Use finite sets for other systems, and for sets that are
    not boxes, such as a mover's speed in any direction.

    Attributes:
        system: Dynamics, with the bounds of controls and disturbances.
        axes: One axis for each state of the system, in its order.
        controls: Finite set of controls (k, m); None for the vertices of the system's bounds.
        disturbances: Finite set of disturbances (k, n); None for the vertices of the system's bounds.

    Raises:
        TimeToReachError: Axes or sets do not match the system, an axis goes beyond its state's bounds, or the best
            control or worst disturbance may lie between the bounds, of which only the vertices are tried.
    """

    system: System
    axes: tuple[Axis, ...]
    controls: Array | None = None
    disturbances: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", tuple(self.axes))
        check_system(self.system)
        check_axes(self.system, self.axes)
        check_equations(self.system, self.axes)
        check_grid_within_limits(self.system, self.axes, "the safety solver")
        for name, given, width in (
            ("controls", self.controls, len(self.system.controls)),
            ("disturbances", self.disturbances, len(self.system.disturbances)),
        ):
            if given is not None:
                object.__setattr__(self, name, _finite_set(name, given, width))
        if self.controls is None:
            for state, rate in zip(self.system.states, dependences(self.system), strict=True):
                if rate.control_degree > AFFINE:
                    raise TimeToReachError(
                        f"{self.system.name}: the derivative of '{state.name}' is not affine in the controls, so the "
                        "best one need not be at the bounds: give `controls`, the ones to choose from"
                    )
        if self.disturbances is None:
            check_game(self.system)
            check_disturbances(self.system, self.axes)

    def pairs(self) -> tuple[Array, Array, int]:
        """Return controls (p, m) and disturbances (p, n) of all pairs, and the count of disturbances (vary fastest)."""
        controls = self.controls
        if controls is None:
            controls = self.system.control_samples(2)
        disturbances = self.system.disturbance_samples(2) if self.disturbances is None else self.disturbances
        u = np.repeat(controls, len(disturbances), axis=0)
        return u, np.tile(disturbances, (len(controls), 1)), len(disturbances)


def _finite_set(name: str, given: Sequence[Sequence[float]] | Array, width: int) -> Array:
    points = np.array(given, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != width or not len(points) or not np.isfinite(points).all():
        raise TimeToReachError(f"{name} have shape {points.shape}: give finite numbers, (at least 1, {width})")
    return points

"""A corridor's problem in the coordinates of its path: walls become bounds there, and the path to the goal a line.

    s' = v cos(h) / (1 - kappa(s) l),    l' = v sin(h),    h' = omega - kappa(s) s'

with s along the path, l lateral to the left of it, h the heading relative to it (as in the task's regions), kappa the
path's curvature, its steps rounded off so that a solver can follow them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import inf, pi
from typing import Any

import numpy as np
from ctrl_rl_core.systems.models import Dynamics
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import ArcPath, Quantity, System
from oc_baseline_node.errors import OcError

NAMES = ("s", "lateral", "heading")
"""States of `path_car`."""
_ROUNDED = 0.05
"""Length over which a step of the curvature is rounded off [m]."""
_LARGEST_HEADING = pi / 3
"""Largest heading of a start [rad]: a burger does not stand across a narrow corridor."""


def path_car(car: System, path: ArcPath) -> System:
    """Return the Dubins car in the coordinates of a path, with the controls of `car`.

    Raises:
        OcError: `car` is another model.
    """
    if car.name != "dubins_car":
        raise OcError(f"in a corridor the model must be 'dubins_car', not '{car.name}'")
    states = (
        Quantity("s", "m", 0.0, path.length),
        Quantity("lateral", "m", -inf, inf),
        Quantity("heading", "rad", -_LARGEST_HEADING, _LARGEST_HEADING),
    )
    disturbances = tuple(
        replace(given, name=f"d_{state.name}") for given, state in zip(car.disturbances, states, strict=True)
    )

    def equations(math: Any, _parameters: Mapping[str, float]) -> Dynamics:
        def f(x: Any, u: Any, d: Any) -> tuple[Any, ...]:
            kappa = curvature(path, x[0], math)
            rate = u[0] * math.cos(x[2]) / (1.0 - kappa * x[1])
            return rate + d[0], u[0] * math.sin(x[2]) + d[1], u[1] - kappa * rate + d[2]

        return f

    return System("dubins_car along a path", states, car.controls, disturbances, {}, equations)


def curvature(path: ArcPath, s: Any, math: Any = np) -> Any:
    """Return the path's curvature [rad/m] at s [m], smooth; for arrays and for CasADi."""
    out, begin = 0.0 * s, 0.0
    for arc in path.arcs:
        if arc.curvature != 0.0:
            ends = (math.tanh((s - at) / _ROUNDED) for at in (begin, begin + arc.length))
            out = out + 0.5 * arc.curvature * (next(ends) - next(ends))
        begin += arc.length
    return out


def in_plane(path: ArcPath, states: ArrayLike) -> NDArray[np.float64]:
    """Return x, y, theta (..., 3) of states s, lateral, heading (..., 3)."""
    s, lateral, heading = np.moveaxis(np.asarray(states, dtype=float), -1, 0)
    x, y, direction = np.moveaxis(path.pose(s), -1, 0)
    return np.stack((x - lateral * np.sin(direction), y + lateral * np.cos(direction), direction + heading), axis=-1)

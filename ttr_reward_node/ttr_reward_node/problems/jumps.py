"""Derivatives that jump from one state to the next: mud, a switched gear, dry friction.

A long step across a jump meets it between two evaluations of the derivatives, and its duration may be far off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, System
from ttr_reward_node.problems.dependence import dependences

_LINES = 48  # number of random lines along each axis
_HALVINGS = 8  # number of times the cell with the largest change along a line is halved
_KEPT = 0.5  # part of the change left in 1 / 256 of the cell above which it is a jump
_SMALL = 1e-3  # change within a cell below which it does not matter, relative to the largest derivative


def find_jump(system: System, axes: Sequence[Axis]) -> str:
    """Return the name of a state along which some derivative jumps, or changes within a small part of a cell.

    Looks at random lines along each axis on which the derivatives depend; "" if none jumps there.
    """
    depends = frozenset[int]().union(*(rate.states for rate in dependences(system)))
    random = np.random.default_rng(0)
    nodes = [axis.nodes for axis in axes]
    for k in sorted(depends):
        states = np.stack([random.uniform(each[0], each[-1], _LINES) for each in nodes], axis=-1)
        for u in system.control_samples():
            for d in system.disturbance_samples():
                if _jumps_along(system, k, states, nodes[k], u, d):
                    return system.state_names[k]
    return ""


def _jumps_along(
    system: System,
    k: int,
    states: NDArray[np.float64],
    nodes: NDArray[np.float64],
    u: NDArray[np.float64],
    d: NDArray[np.float64],
) -> bool:
    """Whether some derivative jumps along axis k on a line through one of the states (m, n)."""

    def rates(places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives (m, p, n) at places (m, p) along the axis."""
        x = np.repeat(states[:, None], places.shape[1], axis=1)
        x[..., k] = places
        with np.errstate(all="ignore"):
            return np.asarray(system.dynamics(x, u, d))

    along = rates(np.broadcast_to(nodes, (len(states), len(nodes))))
    changes = np.nan_to_num(np.abs(np.diff(along, axis=1)))
    scale = np.nan_to_num(np.abs(along)).max(axis=(0, 1))
    for i in range(len(system.states)):
        cell = changes[..., i].argmax(axis=1)
        first = changes[np.arange(len(states)), cell, i]
        low, high, left = nodes[cell], nodes[cell + 1], first
        for _ in range(_HALVINGS):
            found = rates(np.stack((low, 0.5 * (low + high), high), axis=1))[..., i]
            parts = np.nan_to_num(np.abs(np.diff(found, axis=1)))
            upper = parts[:, 1] > parts[:, 0]
            low, high = np.where(upper, 0.5 * (low + high), low), np.where(upper, high, 0.5 * (low + high))
            left = parts.max(axis=1)
        if ((left > _KEPT * first) & (first > _SMALL * scale[i])).any():
            return True
    return False

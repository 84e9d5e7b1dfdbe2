"""Compiled in-place Lax-Friedrichs sweep over the nodes (Kao, Osher, Qian 2004; thesis section 3.2.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.stencil import Grid

_OPTIONS = {"error_model": "numpy"}


class Hamiltonian(NamedTuple):
    """Tables of the Hamiltonian max over d, min over u of p . f, axes in the layout's order.

    Attributes:
        rates: Derivatives f in each slab under each pair (slabs, pairs, n).
        controls: Number of controls; the control is the fastest-varying index of the pairs.
        viscosity: Largest speed s along each axis in each slab (slabs, n): local Lax-Friedrichs.
        spacings: Node spacing dx (n,) [unit of the axis].
        rate: Rate lambda of the transform [1/s].
    """

    rates: NDArray[np.float32]
    controls: int
    viscosity: NDArray[np.float64]
    spacings: NDArray[np.float64]
    rate: float


@njit(**_OPTIONS)
def sweep(v: NDArray[np.float64], fixed: NDArray[np.bool_], grid: Grid, hamiltonian: Hamiltonian, bits: int) -> float:
    """Update every node once.

    v = 1 - exp(-lambda phi) (Kruzhkov) lies between 0 and 1 and solves max over d, min over u of grad v . f = lambda (v
    - 1), so a node not yet known (1) weighs no more than an unreachable one. With central differences p, viscosity s
    and the mean m of the two neighbours along each axis,

        v = (sum of s/dx m + lambda + max_d min_u p . f) / (sum of s/dx + lambda).

    Args:
        v: Values at the nodes, flat, in the layout's order; updated in place.
        fixed: Whether each node is fixed because it lies in the target or an obstacle.
        grid: Axes in the layout's order.
        hamiltonian: Tables of the Hamiltonian.
        bits: Sweep direction: axis k is traversed downwards if bit k is set.

    Returns:
        The largest change of v.
    """
    rates, controls, viscosity, spacings, rate = hamiltonian
    counts, periodic, strides, n = grid.counts, grid.periodic, grid.strides, grid.n
    slabs, pairs, _ = rates.shape
    inner_size = v.size // slabs
    index, p = np.zeros(n, np.int64), np.zeros(n)
    largest = 0.0
    for turn in range(v.size):
        rest, node = turn, 0
        for k in range(n - 1, -1, -1):
            i = rest % counts[k]
            rest //= counts[k]
            index[k] = counts[k] - 1 - i if (bits >> k) & 1 else i
            node += index[k] * strides[k]
        if fixed[node]:
            continue
        slab = node // inner_size
        total, scale = rate, rate
        for k in range(n):
            i = index[k]
            if counts[k] == 1:  # the dummy axis has no neighbours
                continue
            if periodic[k]:
                below = v[node + ((i - 1) % counts[k] - i) * strides[k]]
                above = v[node + ((i + 1) % counts[k] - i) * strides[k]]
            else:
                below = v[node - strides[k]] if i > 0 else _beyond(v[node], v[node + strides[k]])
                above = v[node + strides[k]] if i < counts[k] - 1 else _beyond(v[node], v[node - strides[k]])
            p[k] = (above - below) / (2.0 * spacings[k])
            total += viscosity[slab, k] / spacings[k] * 0.5 * (above + below)
            scale += viscosity[slab, k] / spacings[k]
        worst = -np.inf
        for first in range(0, pairs, controls):
            best = np.inf
            for q in range(first, first + controls):
                drift = 0.0
                for k in range(n):
                    drift += p[k] * rates[slab, q, k]
                best = min(best, drift)
            worst = max(worst, best)
        new = min(max((total + worst) / scale, 0.0), 1.0)
        largest = max(largest, abs(new - v[node]))
        v[node] = new
    return largest


@njit(forceinline=True, **_OPTIONS)
def _beyond(edge: float, inner: float) -> float:
    """Extrapolate the value of a ghost node beyond the edge, without inflow (Kao, Osher, Qian)."""
    return min(max(edge + edge - inner, inner), 1.0)

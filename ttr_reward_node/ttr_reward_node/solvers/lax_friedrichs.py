"""Lax-Friedrichs fast sweeping, the thesis's method (section 3.2.2): simple, robust, more diffusive than ours.

Target and obstacles are the nodes inside them: unlike in `semi_lagrangian`, both are snapped to the grid.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttr_reward_node.kernels.entry_points import kernels
from ttr_reward_node.kernels.lax_friedrichs_sweep import Hamiltonian
from ttr_reward_node.kernels.stencil import make_grid
from ttr_reward_node.problems.dependence import check_affine_controls
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.node_flags import flat
from ttr_reward_node.solvers.solution import Progress, SweepResult, require_memory
from ttr_reward_node.solvers.steps import Layout, make_layout, pairs, rates_under_all_pairs, slab_states

_TOLERANCE = 1e-3  # relative to the time to cross a cell
_CROSSINGS = 0.25  # 1 / lambda, in times to cross the grid
_BLOCK = 1 << 16  # number of rates computed at once
_UNREACHABLE = 30.0  # value of lambda phi above which a node is unreachable


def memory_needed(problem: TimeToReachProblem) -> float:
    """Return the peak memory of `solve`, including the value grid [bytes]."""
    layout = make_layout(problem)
    n = len(layout.counts)
    # Rates, states and viscosity.
    table = layout.slabs * n * (len(pairs(problem, problem.system.control_samples(2))[0]) * 4.0 + 32.0)
    return table + problem.points * 22.0 + 2e8  # 200 MB for compilation


def solve(
    problem: TimeToReachProblem,
    *,
    tolerance: float | None = None,
    max_sweeps: int = 5000,
    progress: Progress | None = None,
) -> SweepResult:
    """Solve a problem; arguments as in `solver.solve`."""
    check_affine_controls(problem.system)
    require_memory(memory_needed(problem), problem.points)
    layout = make_layout(problem)
    # f is affine in control and disturbance, so their vertices give the exact Hamiltonian.
    u, d, controls = pairs(problem, problem.system.control_samples(2))
    rates, viscosity = _tabulate(problem, layout, u, d)
    # The spacing of a dummy axis is arbitrary.
    spacings = np.array([problem.axes[k].spacing for k in layout.order] + [1.0])[: len(layout.counts)]
    top = viscosity.max(axis=0)
    unit = float(np.max(spacings[top > 0] / top[top > 0], initial=0.0)) or 1.0
    tolerance = _TOLERANCE * unit if tolerance is None else tolerance
    rate = 1.0 / (_CROSSINGS * unit * max(layout.counts))
    failed = problem.blocked() | problem.outside()
    target = problem.in_target() & ~failed
    v = np.where(flat(target, layout), 0.0, 1.0)
    fixed = flat(target | failed, layout)
    n = len(layout.order)
    grid = make_grid(layout.counts, layout.periodic, len(layout.outer))
    hamiltonian = Hamiltonian(rates, controls, viscosity, spacings, rate)
    residual, number = math.inf, 0
    while number < max_sweeps and residual > tolerance:
        bits = number % (1 << n)
        change = kernels().lax_friedrichs(v, fixed, grid, hamiltonian, bits)
        residual, number = change / rate, number + 1
        if progress is not None:
            progress(number, residual)
    # In place, to save memory.
    with np.errstate(divide="ignore"):
        np.log1p(np.negative(v, out=v), out=v)
    v *= -1.0 / rate
    v[v > _UNREACHABLE / rate] = math.inf
    shaped = v.reshape([problem.counts[k] for k in layout.order]).transpose(np.argsort(layout.order))
    return SweepResult(np.ascontiguousarray(shaped, dtype=np.float32), number, residual, residual <= tolerance)


def _tabulate(
    problem: TimeToReachProblem, layout: Layout, u: NDArray[np.float64], d: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return f (slabs, pairs, n) and its largest magnitude over the pairs (slabs, n); 0 along a dummy axis."""
    states, n = slab_states(problem, layout), len(layout.order)
    rates = np.zeros((len(states), len(u), len(layout.counts)), np.float32)
    viscosity = np.zeros((len(states), len(layout.counts)))
    size = max(1, _BLOCK // len(u))
    for begin in range(0, len(states), size):
        block = slice(begin, begin + size)
        rates[block, :, :n] = rates_under_all_pairs(problem.system, states[block], u, d)[..., layout.order]
        viscosity[block] = np.abs(rates[block]).max(axis=1)
    return rates, viscosity

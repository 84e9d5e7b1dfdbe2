"""Lax-Friedrichs fast sweeping, the thesis's method (section 3.2.2): simple, robust, more diffusive than ours."""

from __future__ import annotations

import math

import numpy as np

from ttr_reward_node.compiled import kernels
from ttr_reward_node.memory import require
from ttr_reward_node.problem import Problem
from ttr_reward_node.semi_lagrangian import flat, make_grid
from ttr_reward_node.solution import Progress, Sweeps
from ttr_reward_node.steps import all_rates, make_layout, pairs, slab_states

_TOLERANCE = 1e-3  # of the time to cross a cell
_CROSSINGS = 0.25  # 1 / lambda, in crossings of the grid
_UNREACHABLE = 30.0  # lambda phi beyond which nothing has arrived


def memory_needed(problem: Problem) -> float:
    """Return the bytes that `solve` will take at most, with those of the value grid."""
    layout = make_layout(problem)
    table = layout.slabs * len(pairs(problem, 2)[0]) * len(problem.axes) * 12.0
    return table + problem.points * 22.0 + 2e8


def solve(
    problem: Problem,
    *,
    tolerance: float | None = None,
    max_sweeps: int = 5000,
    progress: Progress | None = None,
) -> Sweeps:
    """Solve; see `solver.solve`."""
    require(memory_needed(problem), problem.points)
    layout = make_layout(problem)
    # f is affine in control and disturbance: their vertices give the Hamiltonian exactly.
    u, d, controls = pairs(problem, 2)
    states = slab_states(problem, layout)
    rates = all_rates(problem.system, states, u, d)[..., layout.order].astype(np.float32)
    spacings = np.array([problem.axes[k].spacing for k in layout.order])
    viscosity = np.abs(rates).max(axis=1).astype(np.float64)
    top = viscosity.max(axis=0)
    unit = float(np.max(spacings[top > 0] / top[top > 0], initial=0.0)) or 1.0
    tolerance = _TOLERANCE * unit if tolerance is None else tolerance
    rate = 1.0 / (_CROSSINGS * unit * max(layout.counts))
    target = problem.in_target() & ~problem.blocked()
    v = np.where(flat(target, layout), 0.0, 1.0)
    fixed = flat(target | problem.blocked(), layout)
    n = len(layout.order)
    if n < len(layout.counts):  # no inner axis: the layout has a dummy one of a single node
        spacings, viscosity = np.append(spacings, 1.0), np.pad(viscosity, ((0, 0), (0, 1)))
        rates = np.concatenate((rates, np.zeros((*rates.shape[:2], 1), np.float32)), axis=-1)
    grid = make_grid(layout)
    residual, number = math.inf, 0
    while number < max_sweeps and residual > tolerance:
        bits = number % (1 << n)
        change = kernels().lax_friedrichs(v, fixed, grid, spacings, rates, controls, viscosity, rate, bits)
        residual, number = change / rate, number + 1
        if progress is not None:
            progress(number, residual)
    with np.errstate(divide="ignore"):
        phi = -np.log1p(-v) / rate
    phi[phi * rate > _UNREACHABLE] = math.inf
    shaped = phi.reshape([problem.counts[k] for k in layout.order]).transpose(np.argsort(layout.order))
    return Sweeps(np.ascontiguousarray(shaped, dtype=np.float32), number, residual, residual <= tolerance)

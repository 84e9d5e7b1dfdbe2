"""Semi-Lagrangian solver: from each node, steps of a few cells under each control, repeated until nothing changes.

The sweeps run in the phases of `solvers.phases`.
"""

from __future__ import annotations

import numpy as np

from ttr_reward_node.kernels.stencil import StepTable, make_grid
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.devices import CPU, find_device
from ttr_reward_node.solvers.near_nodes import near_share
from ttr_reward_node.solvers.node_flags import flag_nodes
from ttr_reward_node.solvers.phases import CROSSINGS, Phases, Scales
from ttr_reward_node.solvers.solution import Progress, SweepResult, require_memory
from ttr_reward_node.solvers.steps import make_layout, pairs, step_lengths, tried_controls
from ttr_reward_node.solvers.tabulation import make_steps

_TOLERANCE = 0.1  # relative to the time that the slowest axis needs to cross a cell at its top speed
_LONG = 3.5  # length above which a step must end where all corners are reachable and smooth [cells]


def memory_needed(problem: TimeToReachProblem) -> float:
    """Return the peak memory of `solve`, including the value grid [bytes]."""
    layout = make_layout(problem)
    lengths = step_lengths(problem)
    n_pairs = len(lengths) * len(pairs(problem, tried_controls(problem, layout))[0])
    # Codes of the durations, ends, ranges and reach.
    steps = layout.slabs * (
        n_pairs * (2.0 + 2.0 * len(layout.order) + 2.0 * len(layout.inner)) + 2.0 * len(layout.order)
    )
    near = near_share(problem, max(lengths)) * problem.points * n_pairs * 4.0
    rows = 40.0 * problem.points / layout.counts[-1]
    return steps + near + rows + problem.points * 21.0 + 2.5e8  # 250 MB for compilation


def solve(
    problem: TimeToReachProblem,
    *,
    tolerance: float | None = None,
    max_sweeps: int = 1000,
    progress: Progress | None = None,
    device: str = CPU,
) -> SweepResult:
    """Solve a problem; arguments as in `solver.solve`."""
    require_memory(memory_needed(problem), problem.points)
    use = find_device(device)
    layout = make_layout(problem)
    steps, reach = make_steps(problem, layout)
    flags = flag_nodes(problem, layout, reach)
    del reach
    unit = steps.crossing
    tolerance = _TOLERANCE * unit if tolerance is None else tolerance
    crossing = unit * max(layout.counts)
    rate = 1.0 / (CROSSINGS * crossing) if crossing > 0.0 else 1.0
    axes = len(layout.order)
    grid = make_grid(layout.counts[:axes], layout.periodic[:axes], len(layout.outer))
    discounts = np.exp(-rate * steps.durations).astype(np.float32)
    discounts[0] = 0.0
    long = steps.lengths > _LONG
    table = StepTable(steps.codes, steps.ends, steps.ranges, long, steps.controls, discounts, steps.durations)
    sweeper = use(problem, layout, steps, flags, table, grid, rate)
    shape = tuple(problem.counts[k] for k in layout.order)
    phases = Phases(sweeper, shape, Scales(unit, crossing, rate, tolerance), max_sweeps, progress)
    converged = phases.run()
    values = sweeper.values
    number, residual = phases.number, phases.residual
    del steps, table, sweeper, phases  # the tables, so that the result finds room where they were
    with np.errstate(divide="ignore"):
        np.log(values, out=values)
    values *= np.float32(-1.0 / rate)
    phi = np.abs(values).reshape(shape).transpose(np.argsort(layout.order))
    return SweepResult(np.ascontiguousarray(phi), number, residual, converged)

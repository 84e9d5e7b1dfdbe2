"""Error of a decomposition: its lower bound compared with the solution of the whole system on the same nodes.

    problem = problem_from_task("quad_ttr", counts=COARSE_QUADROTOR)
    gaps = measure_decomposition_errors(problem, DECOMPOSITIONS["planar_quadrotor"].values())
    gaps[0].summary()

The whole is solved once, on the finest feasible six-dimensional grid; each decomposition is solved on the same axes.
Both solutions contain the error of that grid, the whole the larger one: the difference combines the errors of the
decomposition and of the grid, and shrinks as the grid is refined (which is why `docs/results/ttr_gap.json` has three
grids).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.decomposition import Decomposition, solve_parts
from ttr_reward_node.solvers.solution import Solution
from ttr_reward_node.solvers.solver import solve
from ttr_reward_node.solvers.steps import crossing_time

COARSE_QUADROTOR = {"x": 15, "v_x": 9, "z": 15, "v_z": 9, "psi": 15, "omega": 5}
"""Grid on which solving the whole quadrotor takes half a minute: 1.4 million nodes."""

Progress = Callable[[str, int, float], None]
"""Function called after each sweep with the name of the solution, the sweep's number and the largest change [s]."""


@dataclass(frozen=True, eq=False)
class DecompositionErrors:
    """Time to reach of the whole system, and the lower bound from one decomposition.

    Attributes:
        problem: Problem of the whole system.
        decomposition: Name of the decomposition.
        whole, bound: Times at the nodes, shape of the grid [s]; +inf if unreachable.
        tolerance: Largest difference that counts as equal [s]: a tenth of the time to cross a cell.
        whole_seconds, parts_seconds: Processor times of the whole and of its parts [s].
        converged: Whether all solutions converged.
    """

    problem: TimeToReachProblem
    decomposition: str
    whole: NDArray[np.float32]
    bound: NDArray[np.float32]
    tolerance: float
    whole_seconds: float
    parts_seconds: float
    converged: bool

    @property
    def differences(self) -> NDArray[np.float32]:
        """Whole minus bound [s] at the nodes outside the target where both are finite, flat."""
        there = np.isfinite(self.whole) & np.isfinite(self.bound) & (self.whole > 0.0)
        return self.whole[there] - self.bound[there]

    def summary(self) -> dict[str, float | int | str | bool | list[int]]:
        """Return figures for a table or JSON; times in s, fractions of 1."""
        free = ~self.problem.blocked()
        whole, bound = np.isfinite(self.whole) & free, np.isfinite(self.bound) & free
        gap = self.differences.astype(np.float64)
        reference = self.whole[np.isfinite(self.whole) & np.isfinite(self.bound) & (self.whole > 0.0)]
        return {
            "task": self.problem.name,
            "decomposition": self.decomposition,
            "obstacles": self.problem.clearance is not None,
            "counts": list(self.problem.counts),
            "nodes": self.problem.points,
            "converged": self.converged,
            "whole_cpu_s": self.whole_seconds,
            "parts_cpu_s": self.parts_seconds,
            "compared_nodes": int(gap.size),
            "mean_time_s": float(reference.mean()),
            "mean_s": float(gap.mean()),
            "median_s": float(np.median(gap)),
            "p95_s": float(np.quantile(gap, 0.95)),
            "largest_s": float(gap.max()),
            "mean_relative": float(gap.sum() / reference.sum()),
            "tolerance_s": self.tolerance,
            "lower_bound": float(np.mean(gap >= -self.tolerance)),
            "lower_bound_exactly": float(np.mean(gap >= 0.0)),
            "equal": float(np.mean(np.abs(gap) <= self.tolerance)),
            "reachable_whole": float(whole.sum() / free.sum()),
            "reachable_bound": float(bound.sum() / free.sum()),
            "reachable_whole_only": float((whole & ~bound).sum() / free.sum()),
        }


def measure_decomposition_errors(
    problem: TimeToReachProblem,
    decompositions: Iterable[Decomposition],
    method: str = "semi_lagrangian",
    *,
    progress: Progress | None = None,
) -> tuple[DecompositionErrors, ...]:
    """Solve the whole and its decompositions on the same axes.

    Args:
        problem: Problem of the whole system.
        decompositions: Decompositions to compare with the whole.
        method: Name of the solver for all solutions, one of `solver.METHODS`.
        progress: Function called after each sweep with the name of the solution, the sweep's number and the largest
            change [s].

    Raises:
        TimeToReachError: The whole does not fit into memory, or a decomposition does not fit the problem.
    """

    def progress_of(name: str) -> Callable[[int, float], None] | None:
        return None if progress is None else lambda sweep, change: progress(name, sweep, change)

    whole = solve(problem, method, progress=progress_of("whole"), certify=False)
    gaps = []
    for decomposition in decompositions:
        _, _, parts = solve_parts(problem, decomposition, method, progress=progress_of(decomposition.name))
        gaps.append(
            DecompositionErrors(
                problem=problem,
                decomposition=decomposition.name,
                whole=whole.grid.values.astype(np.float32, copy=False),
                bound=at_nodes(problem, parts),
                tolerance=0.1 * crossing_time(problem),
                whole_seconds=whole.cpu_seconds,
                parts_seconds=sum(part.cpu_seconds for part in parts),
                converged=whole.converged and all(part.converged for part in parts),
            )
        )
    return tuple(gaps)


def at_nodes(problem: TimeToReachProblem, parts: Sequence[Solution]) -> NDArray[np.float32]:
    """Return the maximum of the parts' solutions at the nodes of the whole, on the same axes."""
    names = problem.system.state_names
    bound = np.full(problem.counts, -np.inf, dtype=np.float32)
    for part in parts:
        kept = [names.index(axis.name) for axis in part.grid.axes]
        shape = [count if k in kept else 1 for k, count in enumerate(problem.counts)]
        np.maximum(bound, part.grid.values.reshape(shape), out=bound)
    return bound


def as_table(gaps: Sequence[DecompositionErrors]) -> str:
    """Format the summaries as a text table, one line each."""
    lines = [
        f"{'decomposition':<14}{'obstacles':>10}{'nodes':>11}{'mean':>9}{'median':>9}{'p95':>9}{'relative':>10}"
        f"{'bound':>8}{'equal':>8}{'CPU whole':>11}{'CPU parts':>11}"
    ]
    for gap in gaps:
        s = gap.summary()
        lines.append(
            f"{s['decomposition']!s:<14}{'yes' if s['obstacles'] else 'no':>10}{s['nodes']:>11,}"
            f"{s['mean_s']:>7.3f} s{s['median_s']:>7.3f} s{s['p95_s']:>7.3f} s{_percent(s['mean_relative']):>10}"
            f"{_percent(s['lower_bound']):>8}{_percent(s['equal']):>8}"
            f"{s['whole_cpu_s']:>9.1f} s{s['parts_cpu_s']:>9.2f} s"
        )
    return "\n".join(lines)


def _percent(fraction: object) -> str:
    assert isinstance(fraction, float)
    return f"{100.0 * fraction:.1f} %"

"""Convergence of the solvers as the grid is refined: errors against exact Dubins paths and the best solution.

rows = convergence_table()
print(as_table(rows))
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttr_reward_node.problems.from_task import problem_from_task
from ttr_reward_node.solvers.solver import METHODS, solve
from ttr_reward_node.verification.exact_times import reference

COUNTS = ((26, 26, 18), (51, 51, 36), (76, 76, 54), (101, 101, 72), (151, 151, 108))
"""Grids of the car with the same aspect ratio of the cells."""

Progress = Callable[[str, int, float], None]
"""Function called after each sweep with the name of the case, the sweep's number and the largest change [s]."""


def measure_errors(value: NDArray[np.float64], times: NDArray[np.float64]) -> dict[str, float]:
    """Return error figures of a value function at states with known exact times to reach.

    Args:
        value: Values at the states (N,) [s]; not finite if marked unreachable.
        times: Exact times (N,) [s].

    Returns:
        `median_s`, `mean_s`, `p95_s` and `mean_relative` of the absolute error, and `bias_s`, the median of the signed
        error, over states outside the target with a value; `missed`, the fraction of states marked unreachable.
    """
    there = np.isfinite(value) & np.isfinite(times) & (times > 0.0)
    error = value[there] - times[there]
    size = np.abs(error)
    return {
        "median_s": float(np.median(size)),
        "mean_s": float(size.mean()),
        "p95_s": float(np.quantile(size, 0.95)),
        "mean_relative": float((size / times[there]).mean()),
        "missed": float(1.0 - np.isfinite(value).mean()),
        "bias_s": float(np.median(error)),
    }


def convergence_table(
    task: str = "car_ttr",
    counts: Sequence[tuple[int, int, int]] = COUNTS,
    methods: Sequence[str] = tuple(METHODS),
    *,
    states: int = 5000,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Solve a Dubins car's task without obstacles on successively finer grids with each method.

    Args:
        task: Task of a Dubins car with a box as its goal.
        counts: Nodes of each grid, the finest last.
        methods: Names of the solvers to compare.
        states: Number of random states for the comparison.
        seed: Random seed for the states.
        progress: Function called after each sweep with the solver's name, the sweep's number and the largest change
            [s].

    Returns:
        Rows for JSON: method, counts, points, sweeps, converged, CPU seconds, errors against the exact times, and
            `median_to_best_s` and `mean_to_best_s`, the differences from the semi-Lagrangian solution on the finest
            grid.
    """
    coarsest = replace(problem_from_task(task, counts=counts[0]), clearance=None)
    exact = reference(coarsest, states, seed)
    rows: list[dict[str, Any]] = []
    values: dict[tuple[str, tuple[int, ...]], NDArray[np.float64]] = {}
    for nodes in counts:
        problem = replace(problem_from_task(task, counts=nodes), clearance=None)
        for method in methods:
            told = None
            if progress is not None:
                name = f"{method} {' x '.join(map(str, nodes))}"
                told = lambda sweep, change, name=name: progress(name, sweep, change)  # noqa: E731
            solution = solve(problem, method, progress=told, certify=False)
            value = np.asarray(solution.grid.value(exact.states))
            values[method, tuple(nodes)] = value
            rows.append(
                {
                    "method": method,
                    "counts": list(nodes),
                    "points": problem.points,
                    "sweeps": solution.sweeps,
                    "converged": solution.converged,
                    "cpu_s": solution.cpu_seconds,
                    **measure_errors(value, exact.times),
                }
            )
    best = values.get(("semi_lagrangian", tuple(counts[-1])))
    if best is not None:
        for row in rows:
            to_best = measure_errors(values[row["method"], tuple(row["counts"])], best)
            row |= {"median_to_best_s": to_best["median_s"], "mean_to_best_s": to_best["mean_s"]}
    return rows


def as_table(rows: Sequence[dict[str, Any]]) -> str:
    """Format the rows as a text table."""
    names = f"{'sweeps':>7} {'median':>9} {'mean':>9} {'relative':>9} {'to best':>9}"
    lines = [f"{'method':<16} {'nodes':>15} {'CPU':>8} {names}"]
    for row in rows:
        nodes = "x".join(map(str, row["counts"]))
        lines.append(
            f"{row['method']:<16} {nodes:>15} {row['cpu_s']:>6.2f} s {row['sweeps']:>7} {row['median_s']:>7.4f} s"
            f" {row['mean_s']:>7.4f} s {100 * row['mean_relative']:>7.2f} %"
            f" {row.get('median_to_best_s', np.nan):>7.4f} s"
        )
    return "\n".join(lines)

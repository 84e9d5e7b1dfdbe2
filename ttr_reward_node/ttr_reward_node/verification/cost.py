"""Solution cost as the grid grows: systems of thesis Table 3.1 with one to six dimensions, points and seconds.

rows = measure_cost()
print(as_table(rows))
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ctrl_rl_core import Axis, Interval, Region, make_system
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.problems.problem_checks import least_count
from ttr_reward_node.solvers.decomposition import PLANAR_QUADROTOR_4D, PLANAR_QUADROTOR_FIVE, Decomposition, split
from ttr_reward_node.solvers.solver import memory_needed, solve

Progress = Callable[[str, int], None]
"""Function called before each solution with the name of the case and its number of points."""

SIZES = (1e3, 1e4, 1e5, 1e6)
"""Approximate numbers of grid points of `measure_cost`."""


@dataclass(frozen=True)
class Case:
    """System with its domain and target; `shares` are relative node counts of the axes.

    `piece` is a decomposition and the index of one of its subsystems; `most` is the maximum number of points.
    """

    system: str
    domain: Mapping[str, tuple[float, float]]
    target: Mapping[str, tuple[float, float]]
    shares: tuple[float, ...]
    piece: tuple[Decomposition, int] | None = None
    most: float = math.inf


_PI = math.pi
_QUADROTOR: dict[str, tuple[float, float]] = {
    "x": (-3.0, 3.0), "v_x": (-2.0, 2.0), "z": (-3.0, 3.0), "v_z": (-2.0, 2.0), "psi": (-_PI, _PI),
    "omega": (-_PI / 2, _PI / 2),
}  # fmt: skip
_QUADROTOR_TARGET: dict[str, tuple[float, float]] = {"x": (-0.7, 0.7), "z": (-0.7, 0.7), "psi": (-0.6, 0.6)}
_PLANE: dict[str, tuple[float, float]] = {"x": (-3.0, 3.0), "y": (-3.0, 3.0)}

CASES = {
    "1D planar quadrotor, x": Case(
        "planar_quadrotor", _QUADROTOR, _QUADROTOR_TARGET, (1.0,), (PLANAR_QUADROTOR_FIVE, 0), 2e4
    ),
    "2D planar quadrotor, v_x, psi": Case(
        "planar_quadrotor", _QUADROTOR, _QUADROTOR_TARGET, (1.0, 1.0), (PLANAR_QUADROTOR_FIVE, 3), 1e5
    ),
    "3D Dubins car": Case(
        "dubins_car",
        {**_PLANE, "theta": (-_PI, _PI)},
        {"x": (-0.3, 0.3), "y": (-0.3, 0.3), "theta": (-0.3, 0.3)},
        (1.4, 1.4, 1.0),
    ),
    "3D point mass": Case(
        "point_mass",
        {**_PLANE, "z": (-3.0, 3.0)},
        {"x": (-0.3, 0.3), "y": (-0.3, 0.3), "z": (-0.3, 0.3)},
        (1.0, 1.0, 1.0),
    ),
    "4D bicycle": Case(
        "bicycle",
        {**_PLANE, "theta": (-_PI, _PI), "delta": (-0.6, 0.6)},
        {"x": (-0.5, 0.5), "y": (-0.5, 0.5)},
        (3.0, 3.0, 2.0, 1.0),
    ),
    "4D planar quadrotor, half": Case(
        "planar_quadrotor", _QUADROTOR, _QUADROTOR_TARGET, (3.0, 2.0, 2.0, 0.5), (PLANAR_QUADROTOR_4D, 0)
    ),
    "5D extended Dubins car": Case(
        "extended_dubins_car",
        {**_PLANE, "theta": (-_PI, _PI), "v": (-2.0, 2.0), "omega": (-2.0, 2.0)},
        {"x": (-0.7, 0.7), "y": (-0.7, 0.7)},
        (1.5, 1.5, 1.2, 0.8, 0.8),
    ),
    "6D planar quadrotor": Case(
        "planar_quadrotor", _QUADROTOR, _QUADROTOR_TARGET, (1.5, 1.0, 1.5, 1.0, 1.5, 0.6)
    ),
    "6D quadrotor rotation": Case(
        "quadrotor_rotation",
        {"phi": (-_PI, _PI), "theta": (-1.0, 1.0), "psi": (-_PI, _PI), "p": (-4.0, 4.0), "q": (-4.0, 4.0),
         "r": (-4.0, 4.0)},
        {"phi": (-0.8, 0.8), "theta": (-0.4, 0.4), "p": (-2.0, 2.0), "q": (-2.0, 2.0), "r": (-2.0, 2.0)},
        (1.4, 1.0, 1.4, 0.9, 0.9, 0.9),
    ),
}  # fmt: skip
"""All models of thesis Table 3.1, and subsystems of the planar quadrotor with one, two and four dimensions."""


@cache
def make_problem(name: str, points: float) -> TimeToReachProblem:
    """Return the case's problem on a grid of about `points` points, with at least the minimum count on each axis."""
    case = CASES[name]
    system = make_system(case.system)
    if case.piece is None:
        kept = system.state_names
    else:
        kept = case.piece[0].subsystems[case.piece[1]]
        kept = tuple(state for state in system.state_names if state in kept)
    scale = (points / math.prod(case.shares)) ** (1.0 / len(kept))
    counts = {state: round(scale * share) for state, share in zip(kept, case.shares, strict=True)}
    axes = tuple(
        Axis(
            state.name,
            state.unit,
            *case.domain[state.name],
            max(counts.get(state.name, 0), least_count(state.periodic)),
            state.periodic,
        )
        for state in system.states
    )
    target = Region({state: Interval(*bounds) for state, bounds in case.target.items()})
    whole = TimeToReachProblem(system, axes, target, control_counts=3 if len(system.controls) < 3 else 2, name=name)
    return whole if case.piece is None else split(whole, case.piece[0])[case.piece[1]].problem


def measure_cost(
    names: Sequence[str] = tuple(CASES),
    sizes: Sequence[float] = SIZES,
    methods: Sequence[str] = ("semi_lagrangian",),
    *,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Solve each case on each grid size.

    Args:
        names: Names of systems, keys of `CASES`.
        sizes: Approximate numbers of points. Sizes above a case's `most` are skipped.
        methods: Names of the solvers, of `solver.METHODS`.
        progress: Function called before each solution with its name and number of points.

    Returns:
        Rows for JSON: system, dimension, method, counts, points, cpu_s, sweeps, converged, memory_bytes.
    """
    rows = []
    for name in names:
        for method in methods:
            # Solve once on a small grid to compile the kernels.
            solve(make_problem(name, min(sizes)), method, max_sweeps=1, certify=False, finer=1)
            # Least numbers of nodes can make two sizes one grid.
            grids = {
                problem.counts: problem for problem in (make_problem(name, s) for s in sizes if s <= CASES[name].most)
            }
            for problem in grids.values():
                if progress is not None:
                    progress(name, problem.points)
                solution = solve(problem, method, certify=False, finer=1)
                rows.append(
                    {
                        "system": name,
                        "dimension": len(problem.axes),
                        "method": method,
                        "counts": list(problem.counts),
                        "points": problem.points,
                        "cpu_s": solution.cpu_seconds,
                        "sweeps": solution.sweeps,
                        "converged": solution.converged,
                        "reachable": solution.reachable,
                        "memory_bytes": memory_needed(problem, method),
                    }
                )
    return rows


def exponent(rows: Sequence[Mapping[str, Any]], least: float = 9e3) -> float:
    """Return k of CPU seconds ~ points^k, fitted to the grids of one system with at least `least` points."""
    used = [row for row in rows if row["points"] >= least]
    points, seconds = (np.log([row[key] for row in used]) for key in ("points", "cpu_s"))
    return float(np.polyfit(points, seconds, 1)[0])


def as_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Format the rows as a text table."""
    lines = [f"{'system':<32} {'method':<16} {'points':>11} {'CPU':>10} {'sweeps':>7} {'per point and sweep':>20}"]
    for row in rows:
        each = 1e9 * row["cpu_s"] / row["points"] / row["sweeps"]
        lines.append(
            f"{row['system']:<32} {row['method']:<16} {row['points']:>11,} {row['cpu_s']:>8.2f} s {row['sweeps']:>7}"
            f" {each:>17.0f} ns{'' if row['converged'] else '  NOT converged'}"
        )
    return "\n".join(lines)

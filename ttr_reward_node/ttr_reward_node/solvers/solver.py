"""Solvers of time-to-reach problems.

solution = solve(problem_from_task("car_ttr"))
grid = solve_task("car_ttr")
phi = grid.value(states)
"""

from __future__ import annotations

import math
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ctrl_rl_core import NavigationTask, ValueFunction, ValueGrid
from ttr_reward_node.certificates.certificate import certify as make_certificate
from ttr_reward_node.certificates.certificate import finer_advice
from ttr_reward_node.errors import DoubtfulValueWarning, TimeToReachError
from ttr_reward_node.problems.from_task import problem_from_task
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.rewards.rewards import longest_time
from ttr_reward_node.solvers import lax_friedrichs, semi_lagrangian
from ttr_reward_node.solvers.coarser_grid import coarser_problem, grid_note
from ttr_reward_node.solvers.devices import CPU
from ttr_reward_node.solvers.refinement import choose_refinement, coarsen, refine
from ttr_reward_node.solvers.solution import Progress, Solution, SweepResult

METHODS = {"semi_lagrangian": semi_lagrangian, "lax_friedrichs": lax_friedrichs}


def memory_needed(problem: TimeToReachProblem, method: str = "semi_lagrangian", finer: int | None = None) -> float:
    """Return the peak memory of `solve` [bytes]; arguments as there.

    Raises:
        TimeToReachError: An unknown method, or a non-positive number of cells.
    """
    solver = _method(method)
    return float(solver.memory_needed(refine(problem, _refinement(problem, solver, finer))))


def solve(
    problem: TimeToReachProblem,
    method: str = "semi_lagrangian",
    *,
    tolerance: float | None = None,
    max_sweeps: int | None = None,
    progress: Progress | None = None,
    certify: bool = True,
    finer: int | None = None,
    device: str = CPU,
) -> Solution:
    """Compute phi of thesis Eq. 2.18 on the grid.

    Args:
        problem: Time-to-reach problem to solve.
        method: "semi_lagrangian", or the thesis's "lax_friedrichs" (section 3.2), which is less accurate.
        tolerance: Largest change of phi in a sweep at convergence [s]; default: a tenth of the time to cross a cell, or
            a thousandth for Lax-Friedrichs, which converges slowly.
        max_sweeps: Maximum number of sweeps; beyond it the result is marked as not converged, and is +inf where the
            semi-Lagrangian method has not yet found a time of the right magnitude.
        progress: Function called after each sweep with its number and the largest change [s].
        certify: Whether to certify the solution, which takes a tenth of a second or a few per cent of the time, and to
            solve it again on about half of the nodes along each axis. Each doubt is issued as a
            DoubtfulValueWarning, and recorded in the solution's certificate.
        finer: Number of cells into which each grid cell is split along each axis while solving; the result contains the
            values at the original nodes. Default: up to 4 on two axes if that costs about a second; otherwise 1.
        device: "cpu", or "cuda" ("cuda:1" for a second one) to solve on a GPU, which needs NVIDIA Warp; "warp:cpu" runs
            the GPU's kernels on the CPU, for tests. Semi-Lagrangian only.

    Raises:
        TimeToReachError: An unknown method or device, a non-positive tolerance or number of sweeps or cells, or a
            problem that does not fit into memory. Raised before any computation.
    """
    if tolerance is not None and not (math.isfinite(tolerance) and tolerance > 0.0):
        raise TimeToReachError(f"tolerance {tolerance:g} s: it must be above 0")
    if max_sweeps is not None and max_sweeps < 1:
        raise TimeToReachError(f"{max_sweeps} sweeps at most: allow 1 or more")
    solver = _method(method)
    finer = _refinement(problem, solver, finer)
    solved = refine(problem, finer)
    memory = solver.memory_needed(solved)
    options: dict[str, Any] = {} if max_sweeps is None else {"max_sweeps": max_sweeps}
    if device != CPU:
        if solver is not semi_lagrangian:
            raise TimeToReachError(f"method '{method}' runs on the CPU alone: leave the device out")
        options["device"] = device
    begin = time.process_time()
    sweeps = solver.solve(solved, tolerance=tolerance, progress=progress, **options)
    seconds = time.process_time() - begin
    sweeps = replace(sweeps, phi=coarsen(sweeps.phi, problem.axes, finer))
    reachable = float(np.isfinite(sweeps.phi).mean())
    notes = {
        **problem.obstacle_notes(),
        "sweeps": str(sweeps.number),
        "finer": str(finer),
        "converged": "yes" if sweeps.converged else "no",
        "system": problem.system.name,
        "reachable": f"{reachable:.4f}",
        "disturbances": str(problem.disturbances),
        **({} if device == CPU else {"device": device}),
    }
    certificate = make_certificate(_make_grid(problem, method, sweeps, notes), problem) if certify else None
    if certificate is not None:
        rough = coarser_problem(problem, finer) if sweeps.converged else None
        if rough is not None:
            other = _make_grid(rough, method, solver.solve(rough, **options), notes)
            line = grid_note(problem, _make_grid(problem, method, sweeps, notes), other, finer, finer_advice(problem))
            certificate = replace(certificate, grid=line)
        notes |= certificate.as_notes()
        for doubt in certificate.doubts:
            warnings.warn(doubt, DoubtfulValueWarning, stacklevel=2)
    grid = _make_grid(problem, method, sweeps, notes)
    return Solution(grid, sweeps.number, sweeps.residual, sweeps.converged, seconds, reachable, memory, certificate)


def _make_grid(problem: TimeToReachProblem, method: str, sweeps: SweepResult, notes: dict[str, str]) -> ValueGrid:
    # A file cannot hold an infinite residual. Nodes still became reachable: record the largest time instead.
    finite = sweeps.phi[np.isfinite(sweeps.phi)]
    residual = sweeps.residual if np.isfinite(sweeps.residual) else float(finite.max(initial=0.0))
    return ValueGrid(
        values=sweeps.phi,
        axes=problem.axes,
        kind="time_to_reach",
        task=problem.name,
        task_digest=problem.content_digest,
        solver=method,
        residual=residual,
        notes=notes,
    )


def check_reached(problem: TimeToReachProblem, value: ValueFunction) -> None:
    """Check that some state outside the goal can reach it.

    Raises:
        TimeToReachError: No state can reach the goal; the likely cause is named.
    """
    if any(np.isfinite(grid.values).any() for grid in value.grids) and longest_time(value) > 0.0:
        return
    inside = problem.in_target()
    if inside.all():
        why = "it covers the whole grid"
    elif inside.any() and problem.blocked()[inside].all():
        why = f"walls or obstacles cover it, widened by {problem.inflation:g} m"
    elif inside.any():
        why = "no control leads into it, against the disturbance and round the obstacles"
    else:
        why = "it is too small for the grid, or no control leads into it"
    raise TimeToReachError(f"nothing outside the goal reaches it: {why}; no file is written")


def solve_task(task: NavigationTask | str | Path, method: str = "semi_lagrangian", **options: Any) -> ValueGrid:
    """Compute the value grid of a navigation task, with the options of `problem_from_task`.

    Raises:
        TimeToReachError: The task has no such problem, or the solver rejects it.
    """
    return solve(problem_from_task(task, **options), method).grid


def _refinement(problem: TimeToReachProblem, solver: Any, finer: int | None) -> int:
    if finer is None:
        return choose_refinement(problem) if solver is semi_lagrangian else 1
    if finer < 1:
        raise TimeToReachError(f"{finer} cells for each of the grid's: take 1 or more")
    return finer


def _method(name: str) -> Any:
    if name not in METHODS:
        raise TimeToReachError(f"unknown method '{name}'; choose one of {', '.join(METHODS)}")
    return METHODS[name]

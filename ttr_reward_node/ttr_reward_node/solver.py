"""Solve a time-to-reach problem: `solve(problem)`, or `solve_task("car_ttr")` for the value grid of a task."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ctrl_rl_core.tasks import NavigationTask
from ctrl_rl_core.value_grid import ValueGrid

from ttr_reward_node import semi_lagrangian
from ttr_reward_node.problem import problem_from_task


def solve_task(task: NavigationTask | str | Path, **options: Any) -> ValueGrid:
    """Value grid of a navigation task; options as for `problem_from_task`."""
    problem = problem_from_task(task, **options)
    phi, sweeps, residual, _, _ = semi_lagrangian.solve(problem, cells=(2.0, 3.0), interp=2, jump=0.5)
    return ValueGrid(
        values=phi,
        axes=problem.axes,
        kind="time_to_reach",
        task=problem.name,
        task_digest=problem.digest,
        solver="semi_lagrangian",
        residual=float(residual),
        notes={"sweeps": str(sweeps)},
    )

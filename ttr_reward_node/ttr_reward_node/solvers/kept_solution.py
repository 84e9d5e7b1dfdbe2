"""Cache of time-to-reach functions: solved once, and kept as files."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from ctrl_rl_core import NavigationTask, task_digest
from ttr_reward_node.problems.from_task import problem_from_task
from ttr_reward_node.solvers.solver import check_reached, solve

Tell = Callable[[str], None]


def find_or_solve(
    task: NavigationTask,
    folder: Path,
    tell: Tell = lambda _: None,
    posed_as: NavigationTask | None = None,
    clearance: float = 0.0,
) -> Path:
    """Return the file with the time to reach of this version of a task; solve it if there is none.

    Obstacles are inflated by the radius of the body plus the clearance.

    Args:
        task: Task that gives the file its name and digest.
        folder: Folder of the files.
        tell: Function called with one line of text before the solver starts.
        posed_as: Task with the grid and the controls of the problem; default: `task` itself.
        clearance: Distance between body and obstacles [m].

    Raises:
        TimeToReachError: The task has no grid, or no state outside the goal can reach it.
    """
    digest = task_digest(task)
    kept_off = f"-{clearance:g}m" if clearance else ""
    file = folder / f"{task.name}-{digest[:12]}{kept_off}.safetensors"
    folder.mkdir(parents=True, exist_ok=True)
    if file.is_file():
        return file
    problem = problem_from_task(posed_as or task, inflation=task.robot.radius + clearance)
    tell(f"solving    {task.name}, {problem.points} nodes")
    solution = solve(dataclasses.replace(problem, digest=digest))
    check_reached(problem, solution.grid)
    solution.grid.save(file, overwrite=True)
    return file

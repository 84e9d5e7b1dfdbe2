"""Times to reach of the tasks, solved once and kept as files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ttr_reward_node.solvers.solver import check_reached

from ctrl_rl_core import NavigationTask, task_digest
from ttr_reward_node import problem_from_task, solve

Tell = Callable[[str], None]


def value_file(task: NavigationTask, folder: Path) -> Path:
    """Return where the time to reach of this version of a task is kept."""
    return folder / f"{task.name}-{task_digest(task)[:12]}.safetensors"


def find_or_solve(task: NavigationTask, folder: Path, tell: Tell = lambda _: None) -> Path:
    """Return the file of a task's time to reach, solved now unless it is there.

    Obstacles are wider by the radius of the body.

    Args:
        task: Task with a `grid`.
        folder: Folder of the files.
        tell: Takes a line before the solver begins.

    Raises:
        TimeToReachError: The task has no grid, or nothing reaches its goal.
    """
    file = value_file(task, folder)
    folder.mkdir(parents=True, exist_ok=True)
    if file.is_file():
        return file
    problem = problem_from_task(task, inflation=task.robot.radius)
    tell(f"solving    {task.name}, {problem.points} nodes")
    solution = solve(problem)
    check_reached(problem, solution.grid)
    solution.grid.save(file, overwrite=True)
    return file

"""Check a task's time to reach by driving: the greedy policy should arrive, and take as long as promised.

result = check_task("car_ttr")
result["reached"], result["ratio_median"]
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.regions import position_indices
from ctrl_rl_core.task_parts import World
from ctrl_rl_core.tasks import NavigationTask, load_navigation_task
from ctrl_rl_core.value_function import ValueFunction
from numpy.typing import NDArray

from ttr_reward_node.problem import Problem, problem_from_task
from ttr_reward_node.roll_out import RollOuts, roll_out
from ttr_reward_node.solution import Progress
from ttr_reward_node.solver import solve


def check_task(
    task: NavigationTask | str | Path,
    *,
    obstacles: bool = True,
    margin: float | None = None,
    states: int = 1000,
    seed: int = 0,
    method: str = "semi_lagrangian",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Solve a task, drive from random states by its value function, and compare the executed with the predicted time.

    Args:
        task: a task with a grid, of a system whose controls need no finer look than a cell (a car).
        obstacles: with the task's walls and obstacles, or without any.
        margin: by how much the solver widens them [m]; half a cell unless given. Shortest paths graze corners, and a
            path between nodes is known to a part of a cell: without a margin a third of the roll-outs touch a corner.
            Collisions are with the true obstacles.
        states: how many starts.
        seed: of the random starts.
        method: see `solve`.
        progress: see `solve`.

    Returns:
        Figures for JSON: fractions of 1, times in s; `ratio_...` is executed over predicted time of those that arrived.
    """
    if not isinstance(task, NavigationTask):
        task = load_navigation_task(task)
    problem = problem_from_task(task)
    if margin is None:
        plane = () if problem.clearance is None else problem.clearance.axes
        margin = 0.5 * max((problem.axes[k].spacing for k in plane), default=0.0)
    problem = problem_from_task(task, inflation=margin) if obstacles else replace(problem, clearance=None)
    solution = solve(problem, method, progress=progress)
    world = task.build_world() if obstacles else None
    starts = random_starts(solution.grid, problem, states, seed, world=world)
    outcome = roll_out(solution.grid, problem, starts, world=world)
    return {
        "task": task.name,
        "method": method,
        "counts": list(problem.counts),
        "obstacles": obstacles,
        "margin_m": margin if obstacles else 0.0,
        "starts": len(starts),
        "solve_cpu_s": solution.cpu_seconds,
        **summary(outcome),
    }


def random_starts(
    value: ValueFunction, problem: Problem, count: int, seed: int = 0, *, world: World | None = None
) -> NDArray[np.float64]:
    """Draw random states (count, n), outside the target and the world's obstacles, from which it can be reached."""
    plane = position_indices(problem.system.state_names)
    random = np.random.default_rng(seed)
    lower, upper = np.array([(axis.lower, axis.upper) for axis in problem.axes]).T
    starts = np.empty((0, len(lower)))
    while len(starts) < count:
        some = random.uniform(lower, upper, (count, len(lower)))
        times = value.value(some)
        kept = np.isfinite(times) & (times > 0.0)
        if world is not None:
            kept &= world.signed_distance(some[:, plane]) > 0.0
        starts = np.concatenate((starts, some[kept]))
    return starts[:count]


def summary(outcome: RollOuts) -> dict[str, float]:
    """Return the figures of roll-outs: how they ended, and quantiles of the executed over the predicted time."""
    ratio = outcome.ratio
    low, median, high = np.quantile(ratio, (0.05, 0.5, 0.95)) if len(ratio) else (np.nan,) * 3
    return {
        "reached": float(outcome.reached.mean()),
        "collided": float(outcome.collided.mean()),
        "left": float(outcome.left.mean()),
        "ratio_p05": float(low),
        "ratio_median": float(median),
        "ratio_p95": float(high),
    }

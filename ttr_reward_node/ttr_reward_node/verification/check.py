"""Verification of a time-to-reach function by driving: the greedy policy should arrive in the predicted time.

result, _ = check_value(load_value("car_ttr.safetensors"), load_navigation_task("car_ttr"))
result["reached"], result["ratio_median"]
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.values import check_function
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, ValueFunction, World, load_navigation_task, position_indices
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.from_task import disturbances_from_notes, problem_from_task
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.rewards.rewards import KIND
from ttr_reward_node.solvers.solution import Progress
from ttr_reward_node.solvers.solver import solve
from ttr_reward_node.verification.roll_out import RollOuts, roll_out

_FEW = 0.02
"""Fraction of colliding roll-outs above which advice is given."""
_MOST_DRAWS = 1000
"""Maximum number of random states drawn per start state."""


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
    """Solve a task, drive from random states by its value function, and compare executed and predicted times.

    Args:
        task: Task with a grid, for a system whose controls need no finer steps than a cell (a car).
        obstacles: Whether to include the task's walls and obstacles.
        margin: Distance by which the solver inflates obstacles [m]; default: half a cell. Shortest paths graze corners,
            and paths between nodes are known only to a fraction of a cell: without a margin a quarter of the roll-outs
            touch a corner. Collisions are with the true obstacles.
        states: Number of random start states.
        seed: Random seed for the start states.
        method: Name of the solver, one of `solver.METHODS`.
        progress: Function called after each sweep with its number and the largest change [s].

    Returns:
        Figures for JSON: fractions of 1, times in s; `ratio_...` is executed / predicted time of the roll-outs that
            arrived.
    """
    if not isinstance(task, NavigationTask):
        task = load_navigation_task(task)
    problem = problem_from_task(task)
    if margin is None:
        plane = () if problem.clearance is None else problem.clearance.axes
        margin = 0.5 * max((problem.axes[k].spacing for k in plane), default=0.0)
    problem = problem_from_task(task, inflation=margin) if obstacles else replace(problem, clearance=None)
    solution = solve(problem, method, progress=progress, certify=False)
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


def check_value(
    value: ValueFunction, task: NavigationTask, *, width: float | None = None, states: int = 1000, seed: int = 0
) -> tuple[dict[str, float], TimeToReachProblem]:
    """Drive from random states by a task's value function, in the task's world; return figures and problem.

    The problem has the disturbances in the function's notes; a constant one, such as a steady current, acts during the
    drive. The figures are those of `check_task`.

    Args:
        value: Time-to-reach function to check.
        task: Task of the function.
        width: Width of the task's corridor [m], None for its own.
        states: Number of random start states.
        seed: Random seed for the start states.

    Raises:
        ValueFunctionError: The function does not belong to the task.
        TaskError: The width does not fit the task.
        TimeToReachError: The function has no state to start from.
    """
    check_function(value, task, KIND)
    problem = problem_from_task(
        task,
        counts={axis.name: axis.count for grid in value.grids for axis in grid.axes},
        inflation=float(value.grids[0].notes.get("inflation", 0.0)),
        width=width,
        disturbances=disturbances_from_notes(value.grids[0].notes),
    )
    # A system without positions has no walls.
    world = None if problem.clearance is None else task.build_world(width)
    starts = random_starts(value, problem, states, seed, world=world)
    return summary(roll_out(value, problem, starts, world=world)), problem


def random_starts(
    value: ValueFunction, problem: TimeToReachProblem, count: int, seed: int = 0, *, world: World | None = None
) -> NDArray[np.float64]:
    """Draw random states (count, n) outside the target and the world's obstacles that can reach the target.

    Raises:
        TimeToReachError: There are too few such states.
    """
    plane = position_indices(problem.system.state_names)
    random = np.random.default_rng(seed)
    ends = np.array([[axis.lower for axis in problem.axes], [axis.upper for axis in problem.axes]])
    lower, upper = np.clip(ends, *problem.limits)
    starts, drawn = np.empty((0, len(lower))), 0
    while len(starts) < count:
        if drawn >= _MOST_DRAWS * count:
            raise TimeToReachError(
                f"only {len(starts)} of {drawn} random states can reach the goal: ask for fewer starts"
            )
        some = random.uniform(lower, upper, (count, len(lower)))
        drawn += count
        times = value.value(some)
        kept = np.isfinite(times) & (times > 0.0)
        if world is not None:
            kept &= world.signed_distance(some[:, plane]) > 0.0
        starts = np.concatenate((starts, some[kept]))
    return starts[:count]


def as_line(figures: Mapping[str, float]) -> str:
    """Format the figures of roll-outs as one line of text."""
    return (
        f"reached {100 * figures['reached']:5.1f} %  collided {100 * figures['collided']:4.1f} %  executed/predicted "
        f"median {figures['ratio_median']:.4f}, 95 % {figures['ratio_p95']:.4f}"
    )


def advice(figures: Mapping[str, float], problem: TimeToReachProblem, radius: float) -> str:
    """Return why roll-outs collide and a remedy; empty if few collide, or if there is a margin.

    Args:
        figures: Figures of the roll-outs, from `check_value`.
        problem: Problem with the clearance and its inflation.
        radius: Radius of the robot [m].
    """
    if problem.clearance is None:
        return ""
    margin = 0.5 * max(problem.axes[k].spacing for k in problem.clearance.axes)
    if figures["collided"] <= _FEW or problem.inflation >= margin:
        return ""
    return (
        f"cause      obstacles were widened by {problem.inflation:g} m, so the shortest paths graze them\n"
        f"remedy     solve again with --robot-size ({radius:g} m), or with --inflation {margin:.2g} or more"
    )


def summary(outcome: RollOuts) -> dict[str, float]:
    """Return the figures of roll-outs: outcomes, and quantiles of executed / predicted time."""
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

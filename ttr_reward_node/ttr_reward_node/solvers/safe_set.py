"""Safe set of a navigation task: states that can avoid its walls and obstacles, or reach its goal without contact."""

from __future__ import annotations

from typing import Literal

import numpy as np
from ctrl_rl_core.tasks import ANGLES
from numpy.typing import NDArray

from ctrl_rl_core import ValueGrid, position_indices
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.problems.safety import SafetyGame
from ttr_reward_node.solvers.safety import SafetySolution, SafetySolver
from ttr_reward_node.solvers.solution import Progress

SafetyKind = Literal["avoid", "reach_avoid"]


def solve_safe_set(
    problem: TimeToReachProblem,
    kind: SafetyKind = "avoid",
    *,
    horizon: float | None = None,
    tolerance: float | None = None,
    max_steps: int | None = None,
    progress: Progress | None = None,
) -> tuple[ValueGrid, SafetySolution]:
    """Solve the safety game in the world of a time-to-reach problem.

    Args:
        problem: System, axes, obstacles and, for "reach_avoid", the target.
        kind: "avoid" to avoid all obstacles, "reach_avoid" to reach the target while avoiding them.
        horizon: Duration of the game [s]; None for an infinite horizon.
        tolerance: Largest change at convergence [m]; default: 1e-4 of the range of the distances.
        max_steps: Maximum number of steps; None for the solver's limit.
        progress: Function called after each step with its number and the largest change [m].

    Returns:
        Grid of values [m], non-negative where safe, and details of the solution.

    Raises:
        TimeToReachError: There is nothing to avoid, no state is safe, or the solver rejects the problem.
    """
    if problem.clearance is None:
        raise TimeToReachError(f"task '{problem.name}' has no walls or obstacles in the plane of its system to avoid")
    game = SafetyGame(problem.system, problem.axes)
    limit = {} if max_steps is None else {"max_steps": max_steps}
    solution = SafetySolver(game).solve(
        problem.spread(problem.clearance.values),
        target=target_margin(problem) if kind == "reach_avoid" else None,
        horizon=horizon,
        tolerance=tolerance,
        progress=progress,
        **limit,
    )
    if solution.safe == 0.0:
        goal = " and reach the goal" if kind == "reach_avoid" else ""
        raise TimeToReachError(
            f"no state of the grid can avoid the obstacles{goal}, widened by {problem.inflation:g} m: "
            "no file is written"
        )
    grid = ValueGrid(
        values=solution.values,
        axes=problem.axes,
        kind=kind,
        task=problem.name,
        task_digest=problem.content_digest,
        solver="safety",
        residual=solution.change,
        notes={
            **problem.obstacle_notes(),
            "horizon": "for ever" if horizon is None else repr(float(horizon)),
            "steps": str(solution.steps),
            "converged": "yes" if solution.converged else "no",
            "system": problem.system.name,
            "safe": f"{solution.safe:.4f}",
        },
    )
    return grid, solution


def target_margin(problem: TimeToReachProblem) -> NDArray[np.float64]:
    """Return the depth of each node inside the target (broadcasts to the grid) [m], negative outside.

    Distances along axes other than positions count by their numeric values: 1 rad or 1 m/s as 1 m.
    """
    margin = np.full((1,) * len(problem.axes), np.inf)
    for k, axis in enumerate(problem.axes):
        if axis.name in problem.target.intervals:
            low, high = problem.target.intervals[axis.name]
            offset = axis.nodes - 0.5 * (low + high)
            if axis.name in ANGLES or axis.periodic:
                offset = np.mod(offset + np.pi, 2.0 * np.pi) - np.pi
            margin = np.minimum(margin, problem.along(k, 0.5 * (high - low) - np.abs(offset)))
    if problem.target.disc is not None:
        i, j = position_indices(problem.system.state_names)
        first, second = (problem.along(k, problem.axes[k].nodes) for k in (i, j))
        points = np.stack(np.broadcast_arrays(first, second), axis=-1)
        margin = np.minimum(margin, -problem.target.disc.signed_distance(points))
    return margin

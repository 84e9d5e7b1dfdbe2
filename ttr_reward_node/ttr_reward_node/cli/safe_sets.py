"""The kinds `avoid` and `reach_avoid` of the command `solve`."""

from __future__ import annotations

from pathlib import Path

from tqdm import tqdm

from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.safe_set import SafetyKind, solve_safe_set


def solve_and_save(
    problem: TimeToReachProblem,
    kind: SafetyKind,
    output: Path,
    *,
    horizon: float | None,
    tolerance: float | None,
    max_steps: int | None,
    overwrite: bool,
) -> bool:
    """Solve, write the file, print a summary, and return whether the solver converged.

    Args:
        problem: System, axes, obstacles and target.
        kind: "avoid" or "reach_avoid".
        output: File to write.
        horizon: Duration of the game [s]; None for an infinite horizon.
        tolerance: Largest change in the last step [m]; None for the solver's default.
        max_steps: Maximum number of steps; None for the solver's default.
        overwrite: Whether to replace an existing file.
    """
    print(f"problem    {problem.system.name}, {' x '.join(map(str, problem.counts))} nodes, {kind}")
    with tqdm(desc="solving", unit=" steps", disable=None) as bar:

        def show(_step: int, change: float) -> None:
            bar.set_postfix_str(f"largest change {change:.2g} m", refresh=False)
            bar.update()

        grid, solution = solve_safe_set(
            problem, kind, horizon=horizon, tolerance=tolerance, max_steps=max_steps, progress=show
        )
    grid.save(output, overwrite=overwrite)
    state = "converged" if solution.converged else "NOT converged (allow more with --max-sweeps)"
    print(f"solved     {state} after {solution.steps} steps, {solution.cpu_seconds:.2f} s CPU")
    print(f"residual   {solution.change:.2g} m, the largest change of the last step")
    print(f"safe       {100 * solution.safe:.1f} % of the nodes")
    print(f"file       {output}")
    return solution.converged

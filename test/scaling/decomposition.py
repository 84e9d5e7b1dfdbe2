"""What the quadrotor's decomposition misses at most: roll-outs of the undecomposed one beside those of its halves.

python test/scaling/decomposition.py [--output FILE.json] [--whole FILE.npz] [--count 20] [--starts 300]

The value of the halves bounds the time to reach from below, and whoever arrives bounds it from above. So what the
decomposition misses at a start is at most the shortest roll-out from there, whoever steers, less the value of the
halves. Roll-outs are the drives of the certificate: they may graze
the state's limits by half a cell of the whole.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from _systems import problem_of
from ctrl_rl_core.io import add_results
from numpy.typing import NDArray
from tqdm import tqdm
from ttr_reward_node.certificates import drive
from ttr_reward_node.verification import random_starts

from ctrl_rl_core import Result, ValueFunction, ValueGrid, parse_options
from ttr_reward_node import DECOMPOSITIONS, TimeToReachProblem, problem_from_task, solve, solve_decomposed

Array = NDArray[np.float64]
NAME = "planar quadrotor, undecomposed"
HALVES = DECOMPOSITIONS["planar_quadrotor"]["4d+4d"]
_MOST_STEPS = 5000  # of a roll-out; thrusts turn the pitch rate by a cell within a millisecond


@dataclass
class Options:
    """Measure what the decomposition of the quadrotor misses at most."""

    output: Path = Path("docs/results/ttr_decomposition.json")
    """JSON file for the results."""
    whole: Path | None = None
    """File that holds the values of the whole, or will once they are solved: an hour's work need not be done twice."""
    count: int = 20
    """Nodes on each axis of the whole."""
    starts: int = 300
    """Number of random starts from which the whole says that the goal can be reached."""


def main() -> int:
    """Solve, roll out and write the results."""
    options = parse_options("decomposition", Options)
    problem = problem_of(NAME, (options.count,) * 6)
    whole = _whole(problem, options.whole)
    nodes = f"{options.count}^6"
    task = replace(problem_from_task("quad_ttr"), clearance=None)
    values: dict[str, ValueFunction] = {
        f"undecomposed, {nodes}": whole,
        f"4D + 4D, {options.count}^4 each": solve_decomposed(problem, HALVES),
        "4D + 4D, nodes of the task": solve_decomposed(task, HALVES),
    }
    starts = random_starts(whole, problem, options.starts)
    executed = {name: roll_out(value, problem, starts) for name, value in tqdm(values.items(), disable=None)}
    shortest = np.min(list(executed.values()), axis=0)
    rows = [row for name, value in values.items() for row in _rows(name, value.value(starts), executed[name], shortest)]
    add_results(options.output, "Decomposition of the quadrotor: what it misses at most", [0], rows)
    print(*(f"{row.method}: {row.metric} {row.values[0]:.4g} {row.unit}" for row in rows), sep="\n")
    return 0


def roll_out(value: ValueFunction, problem: TimeToReachProblem, starts: Array) -> Array:
    """Return the times (N,) [s] in which the greedy policy of a value arrives from starts (N, n); inf where never."""
    drives = drive(value, problem, starts, most_steps=_MOST_STEPS, most_looks=np.inf)
    return np.where(drives.ended, drives.taken, np.inf)


def _whole(problem: TimeToReachProblem, file: Path | None) -> ValueGrid:
    if file is not None and file.exists():
        return ValueGrid.load(file)
    solution = solve(problem, certify=False, progress=lambda number, change: print(f"sweep {number}: {change:.3g} s"))
    if not solution.converged:
        raise SystemExit(f"decomposition: not converged after {solution.sweeps} sweeps")
    if file is not None:
        solution.grid.save(file)
    return solution.grid


def _rows(name: str, predicted: Array, executed: Array, shortest: Array) -> list[Result]:
    arrives, known = np.isfinite(executed), np.isfinite(shortest)
    ratio = executed[arrives] / predicted[arrives]
    missed = shortest[known] - predicted[known]
    return [
        Result(name, "fraction that reaches the goal", "1", [float(arrives.mean())]),
        Result(name, "executed / predicted time, median", "1", [float(np.median(ratio))]),
        Result(name, "executed / predicted time, 95 %", "1", [float(np.quantile(ratio, 0.95))]),
        Result(name, "shortest roll-out less value, median", "s", [float(np.median(missed))]),
        Result(name, "shortest roll-out less value, 95 %", "s", [float(np.quantile(missed, 0.95))]),
        Result(name, "shortest roll-out less value, of the time", "1", [float(missed.sum() / shortest[known].sum())]),
        Result(name, "value below the shortest roll-out", "1", [float(np.mean(missed >= 0.0))]),
        Result(name, "starts with a roll-out", "1", [float(known.mean())]),
    ]


if __name__ == "__main__":
    sys.exit(main())

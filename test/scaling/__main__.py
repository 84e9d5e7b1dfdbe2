"""CPU seconds and memory of the time to reach as grids grow, beside hj_reachability where it has the system.

python test/scaling [--output FILE.json] [--peer PYTHON] [--only NAME]

Each grid is solved in a process of its own, whose kernels are compiled on a small grid before; memory is what its peak
grows by. Ours is measured right before and right after the peer: a machine's speed changes within minutes.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _systems import GRIDS, problem_of
from ctrl_rl_core.io import add_results
from tqdm import tqdm

from ctrl_rl_core import Result, parse_options
from ttr_reward_node import solve

PEERS = "car", "pendulum pair"
INSTALL = "it cannot import hj_reachability: pip install -r requirements/benchmarks.txt, or name a Python that has it"


@dataclass
class Options:
    """Measure seconds and memory of the time to reach on growing grids."""

    output: Path = Path("docs/results/ttr_scaling.json")
    """JSON file for the results."""
    peer: Path = Path(sys.executable)
    """Python in which hj_reachability is installed."""
    only: str = ""
    """One system: car, pendulum pair, or planar quadrotor, undecomposed."""
    counts: tuple[int, ...] = ()
    """Nodes on each axis, in place of the usual grids of that system."""
    one: str = ""
    """Solve one grid in this process and print its figures: for the measuring itself."""


def main() -> int:
    """Measure all grids and write the results."""
    options = parse_options("scaling", Options)
    if options.one:
        print(json.dumps(_measure(options.one, options.counts)))
        return 0
    probe = subprocess.run([options.peer, "-c", "import hj_reachability"], capture_output=True, check=False)
    if probe.returncode:
        print(f"scaling: --peer {options.peer}: {INSTALL}", file=sys.stderr)
        return 1
    if options.only and options.only not in GRIDS:
        print(f"scaling: no system '{options.only}': there are {', '.join(GRIDS)}", file=sys.stderr)
        return 1
    grids = [(name, counts) for name, all_counts in GRIDS.items() for counts in all_counts]
    if options.only:
        grids = [(options.only, options.counts)] if options.counts else [g for g in grids if g[0] == options.only]
    rows: list[Result] = []
    for name, counts in tqdm(grids, "scaling", unit=" grids", disable=None):
        rows += _rows(name, counts, options.peer)
        add_results(options.output, "Time to reach on growing grids", [0], rows)
    print(*(f"{row.method}: {row.metric} {row.values[0]:.4g} {row.unit}" for row in rows), sep="\n")
    return 0


def _rows(name: str, counts: tuple[int, ...], peer: Path) -> list[Result]:
    method = f"{name}, {' x '.join(map(str, counts))}"
    first = _in_process(name, counts)
    theirs = _peer_seconds(name, counts, first["longest"], peer) if name in PEERS else None
    second = _in_process(name, counts) if theirs is not None else first
    seconds = min(first["seconds"], second["seconds"])
    rows = [
        Result(method, "seconds", "s", [seconds]),
        Result(method, "wall seconds", "s", [min(first["wall"], second["wall"])]),
        Result(method, "bytes a node", "B", [first["bytes"]]),
        Result(method, "sweeps", "1", [first["sweeps"]]),
    ]
    if theirs is not None:
        rows.append(Result(method, "speed over hj_reachability", "1", [theirs / seconds]))
    return rows


def _in_process(name: str, counts: tuple[int, ...]) -> dict[str, float]:
    command = [sys.executable, str(Path(__file__).parent), "--one", name, "--counts", *map(str, counts)]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(run.stdout.splitlines()[-1])
    return found


def _measure(name: str, counts: tuple[int, ...]) -> dict[str, float]:
    """Solve one grid; CPU and wall seconds, bytes a node by which the peak grows, sweeps, and the longest time [s]."""
    solve(problem_of(name, tuple(max(8, count // 2) for count in counts)), certify=False, finer=1)
    problem = problem_of(name, counts)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.perf_counter()
    solution = solve(problem, certify=False, finer=1)
    wall = time.perf_counter() - begin
    grown = 1024.0 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    if not solution.converged:
        raise SystemExit(f"{name} {counts}: not converged after {solution.sweeps} sweeps")
    finite = solution.grid.values[np.isfinite(solution.grid.values)]
    return {
        "seconds": solution.cpu_seconds,
        "wall": wall,
        "bytes": grown / problem.points,
        "sweeps": float(solution.sweeps),
        "longest": float(np.quantile(finite, 0.99)),
    }


def _peer_seconds(name: str, counts: tuple[int, ...], horizon: float, peer: Path) -> float:
    problem = problem_of(name, counts)
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(
            given,
            system=name,
            counts=counts,
            domain=[(axis.lower, axis.upper) for axis in problem.axes],
            periodic=[axis.periodic for axis in problem.axes],
            box=[tuple(problem.target.intervals[axis.name]) for axis in problem.axes],
            horizon=horizon,
        )
        subprocess.run([peer, Path(__file__).with_name("_hj_reachability.py"), given, found], check=True)
        return float(np.load(found)["seconds"])


if __name__ == "__main__":
    raise SystemExit(main())

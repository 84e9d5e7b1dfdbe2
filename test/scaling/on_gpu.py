"""Seconds and memory of the time to reach on a GPU as grids grow, and how far it is from the CPU's solution.

python test/scaling/on_gpu.py [--output FILE.json] [--device cuda] [--references FOLDER] [--only NAME]

Kernels are compiled on a small grid before. Seconds are of the whole solution, tables included; memory is the GPU's.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import warp
from _systems import problem_of
from ctrl_rl_core.io import add_results

from ctrl_rl_core import Result, parse_options
from ttr_reward_node import solve

GRIDS = {
    "car": ((101, 101, 72),),
    "pendulum pair": ((17,) * 4, (33,) * 4),
    "planar quadrotor, undecomposed": ((12,) * 6, (16,) * 6, (20,) * 6, (24,) * 6),
}
_SMALL = 8  # nodes on each axis of the grid on which the kernels are compiled


@dataclass
class Options:
    """Measure seconds and memory of the time to reach on a GPU."""

    output: Path = Path("docs/results/ttr_scaling.json")
    """JSON file for the results, which are added to those of other devices."""
    device: str = "cuda"
    """Device, as for `solve`."""
    references: Path | None = None
    """Folder of solutions of the CPU: car_101.npz, pair_17.npz and the like, each with an array v."""
    only: str = ""
    """One system: car, pendulum pair, or planar quadrotor, undecomposed."""
    counts: tuple[int, ...] = ()
    """Nodes on each axis, in place of the usual grids of that system."""


def main() -> int:
    """Measure all grids and write the results after each."""
    options = parse_options("on_gpu", Options)
    for name in [options.only] if options.only else GRIDS:
        axes = len(GRIDS[name][0])
        solve(problem_of(name, (_SMALL,) * axes), certify=False, finer=1, device=options.device, max_sweeps=3)
        for counts in [options.counts] if options.counts else GRIDS[name]:
            rows = _measure(name, counts, options)
            add_results(options.output, "Time to reach on growing grids", [0], rows)
            print(*(f"{row.method}: {row.metric} {row.values[0]:.4g} {row.unit}" for row in rows), sep="\n", flush=True)
    return 0


def _measure(name: str, counts: tuple[int, ...], options: Options) -> list[Result]:
    problem = problem_of(name, counts)
    gpu = warp.get_device(options.device.removeprefix("warp:"))
    stamps: list[float] = []
    memory: list[float] = []

    def note(_sweep: int, _change: float) -> None:
        stamps.append(time.perf_counter())
        memory.append(float(warp.get_mempool_used_mem_current(gpu)) if gpu.is_cuda else float("nan"))

    begin = time.perf_counter()
    solution = solve(
        problem,
        certify=False,
        finer=1,
        device=options.device,
        progress=note,
        max_sweeps=600,
    )
    wall = time.perf_counter() - begin
    if not solution.converged:
        raise SystemExit(f"{name} {counts}: not converged after {solution.sweeps} sweeps")
    found = [
        ("wall seconds", "s", wall),
        ("seconds of tables and first sweep", "s", stamps[0] - begin),
        ("seconds of sweeps", "s", stamps[-1] - stamps[0]),
        ("bytes a node, on the device", "B", max(memory) / problem.points),
        ("sweeps", "1", float(solution.sweeps)),
        ("reachable", "1", solution.reachable),
    ]
    reference = options.references and options.references / f"{name.split()[-1]}_{counts[0]}.npz"
    if reference and reference.exists():
        found += _compare(solution.grid.values, np.load(reference)["v"])
    method = f"{name}, {' x '.join(map(str, counts))}, on {gpu.name}"
    return [Result(method, metric, unit, [value]) for metric, unit, value in found]


def _compare(values: np.ndarray, reference: np.ndarray) -> list[tuple[str, str, float]]:
    here, there = np.isfinite(values), np.isfinite(reference)
    off = np.abs(values[here & there] - reference[here & there])
    return [
        ("nodes reachable on one device alone", "1", float((here != there).mean())),
        ("median difference from the CPU", "s", float(np.median(off))),
        ("difference from the CPU, 99 %", "s", float(np.quantile(off, 0.99))),
        ("largest difference from the CPU", "s", float(off.max())),
    ]


if __name__ == "__main__":
    raise SystemExit(main())

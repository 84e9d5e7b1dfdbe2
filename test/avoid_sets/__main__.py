"""Avoid sets beside closed forms and hj_reachability, on the same grids: error, CPU time of one core.

python test/avoid_sets [--output FILE.json] [--peer PYTHON]

Ours is measured right before and right after the peer: a machine's speed changes within minutes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ctrl_rl_core import Result, parse_options, write_results
from ttr_reward_node import SafetySolver

sys.path.insert(0, str(Path(__file__).parents[1]))
from safety_cases import SafetyCase, air3d, double_integrator, pursuit

ACCURACIES = {"very_high": "hj_reachability WENO5", "low": "hj_reachability first order"}
STEPS = {"double integrator": 0.06, "air3D": 0.128, "Dubins pursuit": 0.1}
REPEATS = 5
INSTALL = "it cannot import hj_reachability: pip install -r requirements/benchmarks.txt, or name a Python that has it"


@dataclass
class Options:
    """Measure avoid sets beside closed forms and hj_reachability."""

    output: Path = Path("docs/results/avoid_sets.json")
    """JSON file for the results."""
    peer: Path = Path(sys.executable)
    """Python in which hj_reachability is installed."""


def main() -> int:
    """Measure all games and write the results."""
    options = parse_options("avoid_sets", Options)
    probe = subprocess.run([options.peer, "-c", "import hj_reachability"], capture_output=True, check=False)
    if probe.returncode:
        print(f"avoid_sets: --peer {options.peer}: {INSTALL}", file=sys.stderr)
        return 1
    rows = []
    makers = (double_integrator, air3d, pursuit)
    with tqdm(total=len(makers) * (1 + len(ACCURACIES)), desc="avoid sets", unit=" solutions", disable=None) as bar:
        for make in makers:
            case = make()
            values, before = ours(case)
            bar.update()
            for accuracy, label in ACCURACIES.items():
                peer_error, peer_seconds = peers(case, accuracy, options.peer)
                name = f"{case.name}, {label}"
                rows += [Result(name, "mean error", "%", [peer_error]), Result(name, "CPU time", "s", [peer_seconds])]
                if accuracy == "very_high":
                    seconds = 0.5 * (before + ours(case)[1])
                    rows += [
                        Result(case.name, "mean error", "%", [mean_error(case, values)]),
                        Result(case.name, "CPU time", "s", [seconds]),
                        Result(case.name, "speed over hj_reachability", "1", [peer_seconds / seconds]),
                    ]
                bar.update()
    for row in rows:
        print(f"{row.method:<45} {row.metric:<28} {row.values[0]:10.4g} {row.unit}")
    write_results(options.output, "Avoid sets: errors relative to the size of what is avoided", [0], rows)
    return 0


def ours(case: SafetyCase) -> tuple[np.ndarray, float]:
    """Return the values and the CPU seconds to tabulate and to solve."""
    step = case.horizon / np.ceil(case.horizon / STEPS[case.name])
    SafetySolver(case.game, step=step).solve(case.margin, max_steps=1)  # compiles
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        solution = SafetySolver(case.game, step=step).solve(case.margin, horizon=case.horizon)
        times.append(time.process_time() - begin)
    return solution.values, float(np.median(times))


def peers(case: SafetyCase, accuracy: str, python: Path) -> tuple[float, float]:
    """Return the peer's mean error [%] and CPU seconds."""
    axes = case.game.axes
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "given.npz", Path(folder) / "found.npz"
        np.savez(
            given,
            name=case.name,
            accuracy=accuracy,
            counts=case.margin.shape,
            domain=[(axis.lower, axis.upper) for axis in axes],
            periodic=[axis.periodic for axis in axes],
            margin=case.margin,
            horizon=case.horizon,
        )
        subprocess.run([python, Path(__file__).with_name("_hj_reachability.py"), given, found], check=True)
        with np.load(found) as content:
            return mean_error(case, content["values"]), float(content["seconds"])


def mean_error(case: SafetyCase, values: np.ndarray) -> float:
    """Return the mean error over the known states, relative to the size of what is avoided [%]."""
    return 100.0 * float(np.mean(np.abs(case.errors(values)))) / case.length


if __name__ == "__main__":
    sys.argv[0] = str(Path(__file__).parent)  # its name in the results
    raise SystemExit(main())

"""The time to reach of the thesis's car against hj_reachability and exact paths; of its quadrotor; growth of the cost.

The peer is not among the development requirements: pip install -r requirements/benchmarks.txt
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from _common import Row, row
from ttr_reward_node.solvers import solve_parts
from ttr_reward_node.verification import Reference, exponent, measure_cost, measure_errors, reference

from ctrl_rl_core import ValueGrid
from ttr_reward_node import DECOMPOSITIONS, TimeToReachProblem, problem_from_task, solve

COUNTS = (101, 101, 72)
STATES = 5000
REPEATS = 5
QUADROTOR = {"x": 101, "v_x": 61, "z": 101, "v_z": 61, "psi": 61, "omega": 9}
THESIS_QUADROTOR = 90.0
HALVES = DECOMPOSITIONS["planar_quadrotor"]["4d+4d"]
INSTALL = "hj_reachability is not installed: pip install -r requirements/benchmarks.txt"
_FIRST_USE = """
import time
from ttr_reward_node import problem_from_task, solve
problem = problem_from_task("car_ttr", counts=(21, 21, 18))
begin = time.process_time()
solve(problem)
print(time.process_time() - begin)
"""


def rows() -> list[Row]:
    """Return CPU seconds and errors, each beside the peer's, the thesis's or the exact figure."""
    car = replace(problem_from_task("car_ttr", counts=COUNTS), clearance=None)
    exact = reference(car, STATES)
    solve(car)
    runs = [solve(car) for _ in range(REPEATS)]
    seconds, errors = (
        min(run.cpu_seconds for run in runs),
        measure_errors(runs[0].grid.value(exact.states), exact.times),
    )
    return [
        *_against_peer(car, exact, seconds, errors),
        *_first_use(),
        _quadrotor(),
        *_cost(),
    ]


def _against_peer(car: TimeToReachProblem, exact: Reference, seconds: float, errors: dict[str, float]) -> list[Row]:
    name = "time to reach, car, 101 x 101 x 72"
    if importlib.util.find_spec("hj_reachability") is None:
        print(INSTALL)
        return [
            row(f"{name}: solve", seconds, "s", INSTALL, None),
            row(f"{name}: median error", errors["median_s"], "s", "exact Dubins paths", None),
            row(f"{name}: mean relative error", 100.0 * errors["mean_relative"], "%", "exact Dubins paths", None),
        ]
    out = []
    for label, peer_seconds, peer in _peer(car, exact):
        against = f"hj_reachability {label}"
        out += [
            row(f"{name}: solve", seconds, "s", f"{against}, {peer_seconds:.3g} s", peer_seconds / seconds),
            row(
                f"{name}: median error",
                errors["median_s"],
                "s",
                f"{against}, {peer['median_s']:.3g} s",
                peer["median_s"] / errors["median_s"],
            ),
            row(
                f"{name}: mean relative error",
                100.0 * errors["mean_relative"],
                "%",
                f"{against}, {100.0 * peer['mean_relative']:.3g} %",
                peer["mean_relative"] / errors["mean_relative"],
            ),
            row(
                f"{name}: states held unreachable",
                100.0 * errors["missed"],
                "%",
                f"{against}, {100.0 * peer['missed']:.3g} %",
                None,
            ),
        ]
    return out


def _peer(car: TimeToReachProblem, exact: Reference) -> list[tuple[str, float, dict[str, float]]]:
    """Return label, CPU seconds and errors of each of the peer's schemes."""
    domain = np.array([(axis.lower, axis.upper) for axis in car.axes])
    box = np.array([tuple(car.target.intervals[axis.name]) for axis in car.axes])
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(given, counts=COUNTS, domain=domain, box=box, horizon=float(exact.times.max()) + 1.0)
        subprocess.run([sys.executable, Path(__file__).with_name("_hj_reachability.py"), given, found], check=True)
        content = dict(np.load(found))
    out = []
    for key, label in (("weno5", "WENO5"), ("first_order", "first order")):
        grid = ValueGrid(
            content[f"{key}_phi"].astype(np.float32), car.axes, "time_to_reach", "car_ttr", "0" * 64, label, 0.0
        )
        out.append((label, float(content[f"{key}_seconds"]), measure_errors(grid.value(exact.states), exact.times)))
    return out


def _first_use() -> list[Row]:
    """Return how long the first process compiles, and the next one reads what is kept."""
    times = []
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        for _ in range(2):
            command = [sys.executable, "-c", _FIRST_USE]
            run = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
            times.append(float(run.stdout))
    first, second = times
    return [
        row(
            "time to reach, first solution in the second process",
            second,
            "s",
            f"in the first, which compiles: {first:.3g} s",
            first / second,
        )
    ]


def _quadrotor() -> Row:
    problem, parts, solutions = solve_parts("quad_ttr", HALVES, counts=QUADROTOR)
    del problem
    seconds = sum(solution.cpu_seconds for solution in solutions)
    each = " + ".join(f"{part.problem.points / 1e6:.2f}" for part in parts)
    assert all(solution.converged for solution in solutions)
    return row(
        f"time to reach, quadrotor 4D + 4D, {each} M points",
        seconds,
        "s",
        f"thesis 3.2.2, {THESIS_QUADROTOR:.0f} s",
        THESIS_QUADROTOR / seconds,
    )


def _cost() -> list[Row]:
    """Return how the cost grows with the points; 1 is linear."""
    names = ("3D Dubins car", "4D planar quadrotor, half", "6D planar quadrotor")
    measured = measure_cost(names, (1e4, 1e5, 5e5))
    return [
        row(
            f"cost of {name}, exponent of the points",
            exponent([row for row in measured if row["system"] == name]),
            "1",
            "linear, 1",
            None,
        )
        for name in names
    ]


if __name__ == "__main__":
    print(*rows(), sep="\n")

"""The command `ttr_experiments`: measure the solvers, print the results, and write them as JSON and figures.

ttr_experiments convergence | check | gap | cost [--output FILE.json] [--picture FILE.png]
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from ctrl_rl_core.command import make_command
from tqdm import tqdm

from ctrl_rl_core import Result, load_navigation_task, write_results
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.from_task import problem_from_task
from ttr_reward_node.solvers.decomposition import DECOMPOSITIONS
from ttr_reward_node.verification import convergence, cost, decomposition_error
from ttr_reward_node.verification.check import as_line, check_task

_COARSER = {"x": 11, "v_x": 7, "z": 11, "v_z": 7, "psi": 11, "omega": 5}
_FINER = {"x": 17, "v_x": 11, "z": 17, "v_z": 11, "psi": 17, "omega": 5}
_STARTS = 1000

Measured = tuple[list[Result], Callable[[Path], None] | None]
"""Results and the function that draws them; None if the experiment has no figure."""


@dataclass(frozen=True)
class Options:
    """Measure the time-to-reach solvers: convergence, greedy roll-outs, decomposition error or cost."""

    experiment: Annotated[
        Literal["convergence", "check", "gap", "cost"], tyro.conf.Positional, tyro.conf.arg(metavar="EXPERIMENT")
    ]
    """Name of the experiment."""
    output: Path | None = None
    """JSON file for the results (default: not written)."""
    picture: Path | None = None
    """Figure to draw, for gap and cost (default: not drawn)."""


def _run(options: Options) -> int:
    title, measure, draws = _EXPERIMENTS[options.experiment]
    _check_files(options, draws)
    with tqdm(desc=options.experiment, unit=" steps", disable=None) as bar:

        def show(name: str, *_figures: float) -> None:
            bar.set_postfix_str(name, refresh=False)
            bar.update()

        results, draw = measure(show)
    if options.output is not None:
        write_results(options.output, title, [0], results)
        print(f"figures    {options.output}")
    if options.picture is not None and draw is not None:
        draw(options.picture)
        print(f"picture    {options.picture}")
    return 0


def _check_files(options: Options, draws: bool) -> None:
    """Check that the output files can be written, before hours of measurement.

    Raises:
        TimeToReachError: An option names a file that cannot be written.
    """
    if options.picture is not None and not draws:
        raise TimeToReachError(f"{options.experiment} draws no picture: leave --picture out")
    for option, path in (("output", options.output), ("picture", options.picture)):
        if path is not None and not (path.parent.is_dir() and os.access(path.parent, os.W_OK)):
            raise TimeToReachError(
                f"--{option} {path}: {path.parent} is no folder to write to: make it, or name another"
            )
        if path is not None and path.is_dir():
            raise TimeToReachError(f"--{option} {path} is a folder: name a file")


def _convergence(show: Callable[..., None]) -> Measured:
    rows = convergence.convergence_table(progress=show)
    print(convergence.as_table(rows))
    metrics = {
        "median_s": ("median error", "s"),
        "mean_s": ("mean error", "s"),
        "mean_relative": ("mean relative error", "1"),
        "median_to_best_s": ("median difference to semi-Lagrangian on the finest grid", "s"),
        "missed": ("states held unreachable", "1"),
        "cpu_s": ("CPU time", "s"),
    }
    results = [
        Result(f"{row['method']}, {' x '.join(map(str, row['counts']))}", metric, unit, [row[key]])
        for row in rows
        for key, (metric, unit) in metrics.items()
    ]
    return results, None


def _check(show: Callable[..., None]) -> Measured:
    results = []
    cases = (
        ("no obstacles", False, None),
        ("six cubes, margin 0.05 m", True, None),
        ("six cubes, no margin", True, 0.0),
    )
    for name, obstacles, margin in cases:
        row = check_task("car_ttr", obstacles=obstacles, margin=margin, states=_STARTS)
        show(name)
        print(f"{name:<26} {as_line(row)}")
        for key, metric in (
            ("reached", "fraction that reaches the goal"),
            ("collided", "fraction that collides"),
            ("ratio_median", "executed / predicted time, median"),
            ("ratio_p95", "executed / predicted time, 95 %"),
        ):
            results.append(Result(f"car, {name}", metric, "1", [row[key]]))
    return results, None


def _gap(show: Callable[..., None]) -> Measured:
    task = load_navigation_task("quad_ttr")
    results = []
    for counts in (_COARSER, decomposition_error.COARSE_QUADROTOR, _FINER):
        problem = problem_from_task(task, counts=counts)
        for obstacles in (False, True):
            used = problem if obstacles else replace(problem, clearance=None)
            gaps = decomposition_error.measure_decomposition_errors(
                used, DECOMPOSITIONS["planar_quadrotor"].values(), progress=show
            )
            print(decomposition_error.as_table(gaps))
            results += [result for one in gaps for result in _gap_results(one.summary())]

    def draw(picture: Path) -> None:
        from ttr_reward_node.plots.decomposition_error import draw_decomposition_errors  # keep matplotlib off robots

        draw_decomposition_errors(gaps, task, picture)  # errors on the finest grid, with obstacles

    return results, draw


def _gap_results(row: dict[str, Any]) -> list[Result]:
    where = "obstacles" if row["obstacles"] else "no obstacles"
    name = f"{row['decomposition']}, {' x '.join(map(str, row['counts']))}, {where}"
    metrics = {
        "mean_time_s": ("mean time to reach of the whole", "s"),
        "mean_s": ("mean gap", "s"),
        "median_s": ("median gap", "s"),
        "p95_s": ("95 % of the gaps", "s"),
        "mean_relative": ("gap relative to the whole", "1"),
        "lower_bound": (f"lower bound within {row['tolerance_s']:.2g} s", "1"),
        "lower_bound_exactly": ("lower bound exactly", "1"),
        "equal": (f"equal within {row['tolerance_s']:.2g} s", "1"),
        "reachable_whole": ("nodes that the whole reaches", "1"),
        "reachable_bound": ("nodes that the decomposition reaches", "1"),
        "whole_cpu_s": ("CPU time of the whole", "s"),
        "parts_cpu_s": ("CPU time of the parts", "s"),
    }
    return [Result(name, metric, unit, [row[key]]) for key, (metric, unit) in metrics.items()]


def _cost(show: Callable[..., None]) -> Measured:
    rows = cost.measure_cost(progress=show)
    print(cost.as_table(rows))
    results = [
        result
        for row in rows
        for result in (
            Result(f"{row['system']}, {row['points']:,} points", "CPU time", "s", [row["cpu_s"]]),
            Result(f"{row['system']}, {row['points']:,} points", "sweeps", "1", [row["sweeps"]]),
        )
    ]
    for name in dict.fromkeys(row["system"] for row in rows):
        mine = [row for row in rows if row["system"] == name]
        if sum(row["points"] >= 9e3 for row in mine) > 1:
            results.append(Result(name, "exponent of the points, 1 is linear", "1", [cost.exponent(mine)]))

    def draw(picture: Path) -> None:
        from ttr_reward_node.plots.cost import draw_cost  # keep matplotlib off robots

        draw_cost(rows, picture)

    return results, draw


_EXPERIMENTS: dict[str, tuple[str, Callable[[Callable[..., None]], Measured], bool]] = {
    "convergence": (
        "Time to reach of the car: error against exact Dubins paths as the grid is refined",
        _convergence,
        False,
    ),
    "check": ("Time to reach of the car: greedy roll-outs", _check, False),
    "gap": ("Time to reach of the quadrotor: what the decomposition costs", _gap, True),
    "cost": ("Time to reach: cost as the grid grows", _cost, True),
}
"""Title of the results file, measuring function (reports the name of each step), and whether a figure is drawn."""

main = make_command("ttr_experiments", Options, _run)

if __name__ == "__main__":
    raise SystemExit(main())

"""The commands `train` and `training_figures`: learning with every baseline, and what comes of it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ctrl_rl_core.command import run_command
from ctrl_rl_core.results import write_results
from ctrl_rl_core.tasks import load_navigation_task

from oc_baseline_node.errors import OcError
from oc_baseline_node.training.methods import GROUPS, METHODS

FOLDER = Path("runs/oc_training")
ITERATIONS = 15
_MAIN = ("oc_ppo", "ppo")


def train(arguments: Sequence[str] | None = None) -> int:
    """Learn a task's sparse reward with policy gradients, from several seeds; go on where it was cut off."""
    parser = argparse.ArgumentParser(prog="train", description=train.__doc__)
    parser.add_argument("--task", required=True, help="car_navigation, quad_navigation, quad_trap, or a task file")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--methods", nargs="+", choices=METHODS, help="default: oc_ppo ppo")
    which.add_argument("--compare", nargs="+", choices=[*GROUPS, "all"], help="the methods of a figure or table")
    parser.add_argument("--value", type=Path, help="file of V_oc ('oc fit'); default: what comes with the package")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of the runs (default %(default)s)")
    parser.add_argument("--seeds", type=int, default=5, help="how many, from 0 (default %(default)s)")
    parser.add_argument("--iterations", type=int, default=ITERATIONS, help="of 10240 samples (default %(default)s)")
    parser.add_argument("--workers", type=int, default=0, help="runs at a time (default: one for each core)")
    parser.add_argument("--results", type=Path, help="JSON file to write table and curves to")
    options = parser.parse_args(arguments)
    return run_command("train", lambda: _train(options))


def training_figures(arguments: Sequence[str] | None = None) -> int:
    """Draw success, return, advantages and paths (thesis Fig. 3.9 to 3.16) from the results that `train` wrote."""
    parser = argparse.ArgumentParser(prog="training_figures", description=training_figures.__doc__)
    parser.add_argument("results", type=Path, help="JSON file of `train --results`")
    parser.add_argument("--output", type=Path, default=Path("docs/images"), help="folder (default %(default)s)")
    options = parser.parse_args(arguments)
    return run_command("training_figures", lambda: _figures(options))


def _train(options: argparse.Namespace) -> int:
    # Torch takes seconds to import: not before the arguments are right.
    from ctrl_rl_training.matrix import train_all
    from ctrl_rl_training.training import Options

    from oc_baseline_node.training.results import as_table, collect
    from oc_baseline_node.training.runs import oc_runs

    for name in ("seeds", "iterations"):
        if getattr(options, name) < 1:
            raise OcError(f"--{name} must be at least 1")
    task = load_navigation_task(options.task)  # refuses an unknown one before workers start
    runs = oc_runs(options.task, _methods(options), options.seeds, options.value)
    for run in runs:
        run.description  # noqa: B018 - refuses a missing or wrong V_oc before workers start
    train_all(runs, Options(options.folder, options.iterations), options.workers, task.name)
    rows, figures = collect(runs, options.folder)
    print(as_table(rows))
    if options.results is not None:
        write_results(options.results, f"oc_training_{task.name}", range(options.seeds), rows, figures)
        print(f"results    {options.results}")
    return 0


def _methods(options: argparse.Namespace) -> Sequence[str]:
    if options.compare is None:
        return options.methods or _MAIN
    groups = GROUPS if "all" in options.compare else options.compare
    return list(dict.fromkeys(name for group in groups for name in GROUPS[group]))


def _figures(options: argparse.Namespace) -> int:
    from ctrl_rl_training.results import read_figures

    from oc_baseline_node.training.pictures import draw_all  # matplotlib is not for robots

    figures = read_figures(options.results)
    options.output.mkdir(parents=True, exist_ok=True)
    for picture in draw_all(figures, options.output):
        print(f"picture    {picture}")
    return 0

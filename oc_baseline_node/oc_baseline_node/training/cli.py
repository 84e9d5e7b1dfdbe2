"""The commands `train` and `training_figures`: learning with every baseline, and what comes of it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ctrl_rl_core.command import run_command
from ctrl_rl_core.tasks.task import load_navigation_task
from ctrl_rl_training.cli import (
    add_figure_options,
    add_run_options,
    check_run_options,
    read_training,
    train_and_collect,
)

from oc_baseline_node.training.experiments.methods import GROUPS, METHODS

FOLDER = Path("runs/oc_training")
ITERATIONS = 10
_MAIN = ("oc_ppo", "ppo", "oc_corrected")


def train(arguments: Sequence[str] | None = None) -> int:
    """Learn a task's sparse reward with policy gradients, from several seeds; go on where it was cut off."""
    parser = argparse.ArgumentParser(prog="train", description=train.__doc__)
    parser.add_argument("--task", required=True, help="car_navigation, quad_navigation, quad_trap, or a task file")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--methods", nargs="+", choices=METHODS, help="default: oc_ppo ppo oc_corrected")
    which.add_argument("--compare", nargs="+", choices=[*GROUPS, "all"], help="the methods of a figure or table")
    parser.add_argument("--value", type=Path, help="file of V_oc ('oc fit'); default: what comes with the package")
    add_run_options(parser, FOLDER, ITERATIONS)
    options = parser.parse_args(arguments)
    return run_command("train", lambda: _train(options))


def training_figures(arguments: Sequence[str] | None = None) -> int:
    """Draw success, return, advantages and paths (thesis Fig. 3.9 to 3.16) from the results that `train` wrote."""
    parser = argparse.ArgumentParser(prog="training_figures", description=training_figures.__doc__)
    add_figure_options(parser)
    options = parser.parse_args(arguments)
    return run_command("training_figures", lambda: _figures(options))


def _train(options: argparse.Namespace) -> int:
    check_run_options(options)
    task = load_navigation_task(options.task)
    from oc_baseline_node.training.experiments.results import collect, table
    from oc_baseline_node.training.experiments.runs import oc_runs

    runs = oc_runs(task, _methods(options), options.seeds, options.value)
    for run in runs:
        run.description  # noqa: B018 - refuses a missing or wrong V_oc before workers start
    train_and_collect(options, task, runs, "oc_training", collect, table)
    return 0


def _methods(options: argparse.Namespace) -> Sequence[str]:
    if options.compare is None:
        return options.methods or _MAIN
    groups = GROUPS if "all" in options.compare else options.compare
    return list(dict.fromkeys(name for group in groups for name in GROUPS[group]))


def _figures(options: argparse.Namespace) -> int:
    from oc_baseline_node.training.plots import Learning, draw_all  # matplotlib is not for robots

    figures, task = read_training(options, Learning)
    for picture in draw_all(figures, task, options.output):
        print(f"picture    {picture}")
    return 0

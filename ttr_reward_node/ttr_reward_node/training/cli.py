"""The commands `train` and `training_figures`: learning with every reward, and what comes of it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ctrl_rl_core.command import run_command
from ctrl_rl_core.io.results import ResultsError
from ctrl_rl_training.cli import (
    add_figure_options,
    add_run_options,
    check_run_options,
    read_training,
    train_and_collect,
)
from ctrl_rl_training.sb3.algorithm_names import ALGORITHMS

from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.rewards.rewards import REWARDS

_FOLDER = Path("runs/ttr_training")
_ITERATIONS = 10


def train(arguments: Sequence[str] | None = None) -> int:
    """Learn a task with rewards and algorithms, from several seeds; go on where an earlier call was cut off."""
    parser = argparse.ArgumentParser(prog="train", description=train.__doc__)
    parser.add_argument("--task", required=True, help="car_ttr, quad_ttr, or a task file")
    parser.add_argument("--grid", type=Path, help="its time-to-reach function (.safetensors), for the reward ttr")
    parser.add_argument("--algorithms", nargs="+", choices=ALGORITHMS, default=ALGORITHMS, help="default: all")
    parser.add_argument("--rewards", nargs="+", choices=REWARDS, default=REWARDS, help="default: all")
    add_run_options(parser, _FOLDER, _ITERATIONS)
    options = parser.parse_args(arguments)
    return run_command("train", lambda: _train(options))


def training_figures(arguments: Sequence[str] | None = None) -> int:
    """Draw success, visits and paths (thesis Fig. 3.4 to 3.7) from the results that `train` wrote."""
    parser = argparse.ArgumentParser(prog="training_figures", description=training_figures.__doc__)
    add_figure_options(parser)
    parser.add_argument("--algorithm", choices=ALGORITHMS, help="of visits and paths (default: the first)")
    options = parser.parse_args(arguments)
    return run_command("training_figures", lambda: _figures(options))


def _train(options: argparse.Namespace) -> int:
    check_run_options(options)
    if "ttr" in options.rewards and options.grid is None:
        raise TimeToReachError(f"the reward ttr needs --grid: make it with `solve --task {options.task}`")
    # Torch takes seconds to import: not before the arguments are right.
    from ttr_reward_node.training.results import collect, success_table
    from ttr_reward_node.training.training import reward_runs

    runs = reward_runs(options.task, options.algorithms, options.rewards, options.seeds, options.grid)
    for run in {run.reward: run for run in runs}.values():
        run.environment().close()  # refuses what is wrong before workers start
    train_and_collect(options, runs[0].task, runs, "ttr_training", collect, success_table)
    return 0


def _figures(options: argparse.Namespace) -> int:
    from ctrl_rl_training.plots import draw_paths  # matplotlib is not for robots

    from ttr_reward_node.training.plots import Learning, draw_curves, draw_visits

    figures, task = read_training(options, Learning)
    there = list(dict.fromkeys(method.split(", ")[0] for method in figures["curves"]))
    algorithm = options.algorithm or there[0]
    if algorithm not in there:
        raise ResultsError(f"{options.results}: has no runs of {algorithm}, but of {', '.join(there)}")
    name, method = task.name, f"{algorithm}, ttr"
    pictures = {part: options.output / f"{name}_{part}.png" for part in ("success", "visits", "paths")}
    draw_curves(figures, pictures["success"])
    draw_visits(figures, task, algorithm, pictures["visits"])
    if method in figures["paths"]:
        title = f"{name}: after learning with {algorithm.upper()} and the time-to-reach reward"
        draw_paths(figures["paths"][method], task, title, pictures["paths"])
    else:
        pictures.pop("paths")
    for picture in pictures.values():
        print(f"picture    {picture}")
    return 0

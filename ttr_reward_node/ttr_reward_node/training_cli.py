"""The commands `train` and `training_figures`: learning with every reward, and what comes of it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ctrl_rl_core.command import run_command
from ctrl_rl_core.results import ResultsError, write_results
from ctrl_rl_core.tasks import load_navigation_task
from ctrl_rl_training.algorithm_names import ALGORITHMS

from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.rewards import REWARDS

_FOLDER = Path("runs/ttr_training")


def train(arguments: Sequence[str] | None = None) -> int:
    """Learn a task with rewards and algorithms, from several seeds; go on where an earlier call was cut off."""
    parser = argparse.ArgumentParser(prog="train", description=train.__doc__)
    parser.add_argument("--task", required=True, help="task name: car_ttr or quad_ttr")
    parser.add_argument("--grid", type=Path, help="its time-to-reach function (.safetensors), for the reward ttr")
    parser.add_argument("--folder", type=Path, default=_FOLDER, help="of the runs (default %(default)s)")
    parser.add_argument("--algorithms", nargs="+", choices=ALGORITHMS, default=ALGORITHMS, help="default: all")
    parser.add_argument("--rewards", nargs="+", choices=REWARDS, default=REWARDS, help="default: all")
    parser.add_argument("--seeds", type=int, default=5, help="how many, from 0 (default %(default)s)")
    parser.add_argument("--iterations", type=int, default=10, help="of 10240 samples each (default %(default)s)")
    parser.add_argument("--workers", type=int, default=0, help="runs at a time (default: one for each core)")
    parser.add_argument("--results", type=Path, help="JSON file to write table and curves to")
    options = parser.parse_args(arguments)
    return run_command("train", lambda: _train(options))


def training_figures(arguments: Sequence[str] | None = None) -> int:
    """Draw success, visits and paths (thesis Fig. 3.4 to 3.7) from the results that `train` wrote."""
    parser = argparse.ArgumentParser(prog="training_figures", description=training_figures.__doc__)
    parser.add_argument("results", type=Path, help="JSON file of `train --results`")
    parser.add_argument("--output", type=Path, default=Path("docs/images"), help="folder (default %(default)s)")
    parser.add_argument("--algorithm", choices=ALGORITHMS, help="of visits and paths (default: the first)")
    options = parser.parse_args(arguments)
    return run_command("training_figures", lambda: _figures(options))


def _train(options: argparse.Namespace) -> int:
    # Torch takes seconds to import: not before the arguments are right.
    from ctrl_rl_training.matrix import train_all
    from ctrl_rl_training.training import Options

    from ttr_reward_node.training import reward_runs
    from ttr_reward_node.training_results import collect

    if "ttr" in options.rewards and options.grid is None:
        raise TimeToReachError(f"the reward ttr needs --grid: make it with `solve --task {options.task}`")
    for name in ("seeds", "iterations"):
        if getattr(options, name) < 1:
            raise TimeToReachError(f"--{name} must be at least 1")
    if options.workers < 0:
        raise TimeToReachError("--workers must be at least 0")
    runs = reward_runs(options.task, options.algorithms, options.rewards, options.seeds, options.grid)
    for run in {run.reward: run for run in runs}.values():
        run.environment().close()  # refuses what is wrong before workers start
    train_all(runs, Options(options.folder, options.iterations), options.workers, options.task)
    rows, figures = collect(runs, options.folder)
    for row in rows:
        if row.metric == "success":
            values = " ".join(f"{100 * value:4.0f}" for value in row.values)
            print(f"{row.method:<22} success {values} %")
    if options.results is not None:
        write_results(options.results, f"ttr_training_{options.task}", range(options.seeds), rows, figures)
        print(f"results    {options.results}")
    return 0


def _figures(options: argparse.Namespace) -> int:
    from ctrl_rl_training.pictures import draw_paths  # matplotlib is not for robots
    from ctrl_rl_training.results import read_figures

    from ttr_reward_node.training_pictures import draw_curves, draw_visits

    figures = read_figures(options.results)
    there = list(dict.fromkeys(method.split(", ")[0] for method in figures["curves"]))
    algorithm = options.algorithm or there[0]
    if algorithm not in there:
        raise ResultsError(f"{options.results}: has no runs of {algorithm}, but of {', '.join(there)}")
    name, method = figures["task"], f"{algorithm}, ttr"
    task = load_navigation_task(name)
    options.output.mkdir(parents=True, exist_ok=True)
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

"""What the commands `train` and `training_figures` of several packages share; torch is imported when work begins."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ctrl_rl_core.command import check_least, file_to_write, folder_to_write
from ctrl_rl_core.io.results import Result, ResultsError, write_results
from ctrl_rl_core.tasks.schema.parts import TaskHeader
from ctrl_rl_core.tasks.task import NavigationTask, load_navigation_task, task_digest, task_names

from ctrl_rl_training.experiments.run import Run, RunOptions

if TYPE_CHECKING:
    from ctrl_rl_training.experiments.figure_data import Figures


AnyRun = TypeVar("AnyRun", bound=Run)


def add_run_options(parser: argparse.ArgumentParser, folder: Path, iterations: int) -> None:
    """Give a `train` what says where, how many runs and how long; the arguments are its defaults."""
    parser.add_argument("--folder", type=folder_to_write, default=folder, help="of the runs (default %(default)s)")
    parser.add_argument("--seeds", type=int, default=5, help="how many, from 0 (default %(default)s)")
    parser.add_argument("--iterations", type=int, default=iterations, help="of 10240 samples (default %(default)s)")
    parser.add_argument("--workers", type=int, default=0, help="runs at a time (default: 0, one for each core)")
    parser.add_argument("--results", type=file_to_write, help="JSON file to write table and curves to")
    add_ray_option(parser)


def add_ray_option(parser: argparse.ArgumentParser) -> None:
    """Give a command `--ray`."""
    parser.add_argument("--ray", metavar="ADDRESS", help="Ray cluster that runs them, auto for this machine's")


def check_run_options(options: argparse.Namespace) -> None:
    """Refuse counts that are too small.

    Raises:
        CommandError: names the option.
    """
    check_least(options, seeds=1, iterations=1, workers=0)


def train_and_collect(
    options: argparse.Namespace,
    task: TaskHeader,
    runs: Sequence[AnyRun],
    title: str,
    collect: Callable[[Sequence[AnyRun], Path], tuple[list[Result], dict[str, Any]]],
    as_text: Callable[[list[Result]], str],
    how: RunOptions | None = None,
) -> None:
    """Run what is not finished yet, print the table, and write it and the figures' data if asked to.

    Args:
        options: Options of `add_run_options`.
        task: Task of the runs.
        runs: Runs in the order in which they begin.
        title: Begins the name of the experiment, which ends with the task's.
        collect: Returns the rows and the figures' data of the runs that are finished in a folder.
        as_text: Returns the printed form of the rows.
        how: Settings of the runs; those of Stable-Baselines3 unless given.

    Raises:
        CtrlRlError: See `run_experiments`.
    """
    from ctrl_rl_training.experiments.matrix import run_experiments

    run_experiments(runs, how or _usual(options), options.workers, task.name, options.ray)
    rows, figures = collect(runs, options.folder)
    print(as_text(rows))
    if options.results is not None:
        terms = {"task": task.name, "task_digest": task_digest(task)}
        write_results(options.results, f"{title}_{task.name}", range(options.seeds), rows, {**terms, **figures})
        print(f"results    {options.results}")


def _usual(options: argparse.Namespace) -> RunOptions:
    from ctrl_rl_training.sb3.training import EVALUATIONS, FINAL_EVALUATIONS, ITERATION  # not every run needs them

    return RunOptions(options.folder, options.iterations, ITERATION, EVALUATIONS, FINAL_EVALUATIONS)


def add_figure_options(parser: argparse.ArgumentParser) -> None:
    """Give a `training_figures` what says from what, of which task and where."""
    parser.add_argument("results", type=Path, help="JSON file of `train --results`")
    parser.add_argument("--task", help="its task file, where the task is not one of the suite's")
    parser.add_argument("--output", type=Path, default=Path("docs/images"), help="folder (default %(default)s)")


def read_training(options: argparse.Namespace, kind: type[Figures]) -> tuple[dict[str, Any], NavigationTask]:
    """Return the figures' data of a results file and the task that they belong to, and make the folder of pictures.

    Args:
        options: of `add_figure_options`.
        kind: what the data must be.

    Raises:
        ResultsError: they are not such results, or of another task.
        TaskError: there is no such task.
    """
    from ctrl_rl_training.experiments.results import read_figures

    figures = read_figures(options.results, kind)
    name = figures["task"]
    if options.task is None and name not in task_names():
        raise ResultsError(f"{options.results}: is of task '{name}', none of the suite's: give its file with --task")
    task = load_navigation_task(options.task or name)
    if task.name != name:
        raise ResultsError(f"{options.results}: is of task '{name}', not of '{task.name}': leave --task out")
    size = len(task.system.build().state_names)
    if any(len(path["states"][0]) != size for paths in figures["paths"].values() for path in paths):
        raise ResultsError(f"{options.results}: its paths are not of {size} states, as task '{name}' has")
    if figures.get("task_digest", task_digest(task)) != task_digest(task):
        remark = "is of another version of its task than is drawn: give its file with --task"
        print(f"{Path(sys.argv[0]).name}: {options.results}: {remark}", file=sys.stderr)
    options.output.mkdir(parents=True, exist_ok=True)
    return figures, task

"""Shared options and steps of the `train` and `plot` commands of all packages; torch is imported late."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro
from ctrl_rl_core.command import (
    FolderToWrite,
    OptionalFileToWrite,
)
from ctrl_rl_core.command import NotNegative as NotNegative
from ctrl_rl_core.command import Positive as Positive
from ctrl_rl_core.command import make_command as make_command
from ctrl_rl_core.command import one_of as one_of
from ctrl_rl_core.command import some_of as some_of
from ctrl_rl_core.old_names import make_old_command as make_old_command
from ctrl_rl_core.tasks import TaskHeader

from ctrl_rl_core import (
    NavigationTask,
    Result,
    ResultsError,
    load_navigation_task,
    task_digest,
    task_names,
    write_results,
)
from ctrl_rl_learning.study.run import Run, RunOptions

if TYPE_CHECKING:
    from ctrl_rl_learning.study.results import Figures

AnyRun = TypeVar("AnyRun", bound=Run)
ITERATION = 10_240
"""Samples of an iteration with Stable-Baselines3."""
_EVALUATIONS, _FINAL_EVALUATIONS = 20, 50


@dataclass(frozen=True, kw_only=True)
class ExperimentOptions:
    """Options that mean the same in every command that trains many runs."""

    folder: FolderToWrite
    """Folder of the runs; each run has its own subfolder and resumes there."""
    seeds: Positive = 5
    """Number of seeds, starting from 0."""
    samples: Positive | None = None
    """Samples of a run (default: the task's)."""
    workers: NotNegative = 0
    """Number of parallel runs; 0 for one per core."""
    ray: str | None = None
    """Address of a Ray cluster to train on, or auto for this machine's (default: local processes)."""
    results: OptionalFileToWrite = None
    """JSON file to write the table and curves to."""


@dataclass(frozen=True, kw_only=True)
class SimulatedOptions(ExperimentOptions):
    """Options of a command that trains with Stable-Baselines3."""

    task: str
    """Task to learn: one of the suite, or a task file."""
    samples: Positive = 10 * ITERATION
    """Samples per run, rounded up to iterations of 10240."""
    iterations: Positive | None = None
    """Old name of --samples, in units of 10240."""
    engine: Annotated[str, one_of(("planar", "auto"))] = "planar"
    """Engine to train in: planar (a fleet, if the task fits one) or auto (one robot at a time in PyBullet)."""

    def run_options(self) -> RunOptions:
        """Return the settings of the runs."""
        iterations = self.iterations or math.ceil(self.samples / ITERATION)
        return RunOptions(self.folder, iterations, ITERATION, _EVALUATIONS, _FINAL_EVALUATIONS)


def train_and_collect(
    options: ExperimentOptions,
    task: TaskHeader,
    runs: Sequence[AnyRun],
    title: str,
    collect: Callable[[Sequence[AnyRun], Path], tuple[list[Result], dict[str, Any]]],
    how: RunOptions,
    labels: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Run the unfinished runs, print the table, and write it with the figures' data if requested.

    Args:
        options: Options of the command.
        task: Task of the runs.
        runs: Runs in the order in which they start.
        title: Prefix of the experiment's name; the task's name follows.
        collect: Returns rows and figure data of the finished runs in a folder.
        how: Settings of the runs.
        labels: Labels that replace method names in the table.

    Raises:
        CtrlRlError: See `run_experiments`.
    """
    from ctrl_rl_learning.study.matrix import run_experiments
    from ctrl_rl_learning.study.results import as_table

    run_experiments(runs, how, options.workers, task.name, options.ray)
    rows, figures = collect(runs, options.folder)
    print(as_table(rows, labels))
    if options.results is not None:
        terms = {"task": task.name, "task_digest": task_digest(task)}
        write_results(options.results, f"{title}_{task.name}", range(options.seeds), rows, {**terms, **figures})
        print(f"results    {options.results}")


@dataclass(frozen=True, kw_only=True)
class PlotOptions:
    """Draw learning curves from the results that `train` wrote."""

    results: Annotated[Path, tyro.conf.Positional]
    """JSON file of `train --results`."""
    output: FolderToWrite = Path("docs/images")
    """Folder of the pictures."""


@dataclass(frozen=True, kw_only=True)
class TaskPlotOptions(PlotOptions):
    """Draw learning curves and driven paths from the results that `train` wrote."""

    task: str | None = None
    """Task file, needed if the task does not belong to the suite."""


def find_learnt_task(file: Path, name: str, given: str | None, error: type[Exception]) -> NavigationTask:
    """Return the given task, or else the suite's task that a file names.

    Raises:
        Exception: `error`, if no task is given and the suite has none of that name.
        TaskError: There is no such task.
    """
    if given is None and name not in task_names():
        raise error(f"{file}: belongs to task '{name}', which is not in the suite: give its file by --task")
    return load_navigation_task(given or name)


def read_training(options: TaskPlotOptions, kind: type[Figures]) -> tuple[dict[str, Any], NavigationTask]:
    """Return figure data and task of a results file, and create the folder of the pictures.

    Args:
        options: Options of the command.
        kind: Schema of the data.

    Raises:
        ResultsError: The file holds no such results, or belongs to another task.
        TaskError: There is no such task.
    """
    from ctrl_rl_learning.study.results import read_figures

    figures = read_figures(options.results, kind)
    task = find_learnt_task(options.results, figures["task"], options.task, ResultsError)
    name = task.name
    if name != figures["task"]:
        advice = "omit --task" if figures["task"] in task_names() else "give its file by --task"
        raise ResultsError(f"{options.results}: belongs to task '{figures['task']}', not '{name}': {advice}")
    size = len(task.system.build().state_names)
    if any(len(path["states"][0]) != size for paths in figures["paths"].values() for path in paths):
        raise ResultsError(f"{options.results}: its paths do not have {size} states, as task '{name}' does")
    if figures.get("task_digest", task_digest(task)) != task_digest(task):
        remark = "belongs to another version of its task: give that version's file by --task"
        print(f"{Path(sys.argv[0]).name}: {options.results}: {remark}", file=sys.stderr)
    options.output.mkdir(parents=True, exist_ok=True)
    return figures, task

"""The dialect of the commands `train` and `plot` of every package; torch is imported when work begins."""

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
    """Folder of the runs; each has one of its own, and goes on there where it was cut off."""
    seeds: Positive = 5
    """Number of seeds, counted from 0."""
    samples: Positive | None = None
    """Samples of a run (default: the task's)."""
    workers: NotNegative = 0
    """Runs at a time; 0 for one for each core."""
    ray: str | None = None
    """Address of the Ray cluster that trains, auto for this machine's (default: processes of this machine)."""
    results: OptionalFileToWrite = None
    """JSON file to write table and curves to."""


@dataclass(frozen=True, kw_only=True)
class SimulatedOptions(ExperimentOptions):
    """Options of a command that trains with Stable-Baselines3."""

    task: str
    """Task to learn: one of the suite, or a task file."""
    samples: Positive = 10 * ITERATION
    """Samples of a run; whole iterations of 10240 are done."""
    iterations: Positive | None = None
    """Old name of --samples, in units of 10240."""
    engine: Annotated[str, one_of(("planar", "auto"))] = "planar"
    """Engine to learn in: planar, robots side by side where the task fits, or auto, one at a time in PyBullet."""

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
    """Run what is not finished yet, print the table, and write it and the figures' data if asked to.

    Args:
        options: Options of the command.
        task: Task of the runs.
        runs: Runs in the order in which they begin.
        title: Begins the name of the experiment, which ends with the task's.
        collect: Returns the rows and the figures' data of the runs that are finished in a folder.
        how: Settings of the runs.
        labels: Labels of the methods whose own name does not say enough.

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
    """Draw the curves of learning from the results that `train` wrote."""

    results: Annotated[Path, tyro.conf.Positional]
    """JSON file of `train --results`."""
    output: FolderToWrite = Path("docs/images")
    """Folder of the pictures."""


@dataclass(frozen=True, kw_only=True)
class TaskPlotOptions(PlotOptions):
    """Draw curves and paths of learning from the results that `train` wrote."""

    task: str | None = None
    """Task file, where the task is not one of the suite's."""


def find_learnt_task(file: Path, name: str, given: str | None, error: type[Exception]) -> NavigationTask:
    """Return the task that is given, or else the one of the suite that a file names.

    Raises:
        Exception: `error`, if none is given and the suite has none of that name.
        TaskError: There is no such task.
    """
    if given is None and name not in task_names():
        raise error(f"{file}: is of task '{name}', none of the suite's: give its file with --task")
    return load_navigation_task(given or name)


def read_training(options: TaskPlotOptions, kind: type[Figures]) -> tuple[dict[str, Any], NavigationTask]:
    """Return the figures' data of a results file and the task that they belong to, and make the folder of pictures.

    Args:
        options: Options of the command.
        kind: Schema of the data.

    Raises:
        ResultsError: The file holds no such results, or those of another task.
        TaskError: There is no such task.
    """
    from ctrl_rl_learning.study.results import read_figures

    figures = read_figures(options.results, kind)
    task = find_learnt_task(options.results, figures["task"], options.task, ResultsError)
    name = task.name
    if name != figures["task"]:
        raise ResultsError(f"{options.results}: is of task '{figures['task']}', not of '{name}': leave --task out")
    size = len(task.system.build().state_names)
    if any(len(path["states"][0]) != size for paths in figures["paths"].values() for path in paths):
        raise ResultsError(f"{options.results}: its paths are not of {size} states, as task '{name}' has")
    if figures.get("task_digest", task_digest(task)) != task_digest(task):
        remark = "is of another version of its task than is drawn: give its file with --task"
        print(f"{Path(sys.argv[0]).name}: {options.results}: {remark}", file=sys.stderr)
    options.output.mkdir(parents=True, exist_ok=True)
    return figures, task

"""The commands `compare` and `plot`: the tables and figures of thesis 4.3, each under one budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from ctrl_rl_core.command import FolderToWrite
from ctrl_rl_learning.study import Positive, make_command, make_old_command, one_of

from ctrl_rl_core import CommandError, write_results
from koopman_lqr_controller.cli.run_options import CONSOLIDATION, LearningOptions, given_words
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.environments.benchmark_tasks import find_task
from koopman_lqr_controller.training.experiments.comparisons import COMPARISONS
from koopman_lqr_controller.training.experiments.methods import METHODS, Changes

_WORDS = ("samples", "chunks", "actions", "episodes", "device")
_LIST = "\n".join(
    f"  {name:<12} {each.about}: {', '.join(each.tasks)}\n{'':15}methods {', '.join(each.methods)}"
    for name, each in COMPARISONS.items()
)
_EPILOG = (
    f"comparisons:\n{_LIST}\n\nThe same command goes on where an earlier one was cut off.\n\nexample:\n"
    "  compare --table 4.4 --tasks cartpole_swingup --seeds 3"
)


def _numbers(kind: str) -> Any:
    return one_of([name.partition("-")[2] for name in COMPARISONS if name.startswith(kind)])


@dataclass(frozen=True, kw_only=True)
class Compare(LearningOptions):
    """Train all methods of a table or figure of thesis 4.3 with the same budget, and compare them.

    Finished runs of another comparison or of `train` in the folder are reused.
    """

    table: Annotated[str | None, _numbers("table")] = None
    """Table of the thesis."""
    figure: Annotated[str | None, _numbers("figure")] = None
    """Figure of the thesis."""
    tasks: tuple[str, ...] = ()
    """Tasks (default: all tasks compared in the thesis)."""
    methods: tuple[str, ...] = ()
    """Subset of the methods below (default: all)."""
    seeds: Positive = 3
    """Number of seeds, counted from 0."""
    results: FolderToWrite = Path("docs/results")
    """Folder for tables and curves as JSON."""


@dataclass(frozen=True, kw_only=True)
class Plot:
    """Draw learning curves (thesis Fig. 4.3, 4.8, 4.9) from results written by `compare`."""

    results: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """JSON files written by `compare` or `train`."""
    output: FolderToWrite = Path("docs/images")
    """Folder for the figures."""


def _compare(options: Compare) -> int:
    if (options.table is None) == (options.figure is None):
        raise CommandError("give either --table or --figure")
    changes = options.changes()
    name = f"table-{options.table}" if options.table else f"figure-{options.figure}"
    comparison = COMPARISONS[name]
    tasks, methods = options.tasks or comparison.tasks, options.methods or comparison.methods
    for method in methods:
        if method not in comparison.methods:
            raise KoopmanError(f"--methods {method}: {name} is of {', '.join(comparison.methods)}")
    for task in tasks:
        if task not in comparison.tasks:
            raise KoopmanError(f"--tasks {task}: {name} is of {', '.join(comparison.tasks)}")
        for method in methods:
            find_task(task).with_settings(**dict((*METHODS[method].changes, *changes)))  # fail before importing torch
    for task in tasks:
        _compare_on(task, name, methods, changes, options)
    return 0


def _compare_on(task: str, name: str, methods: Sequence[str], changes: Changes, options: Compare) -> None:
    from ctrl_rl_learning.study import as_table, run_experiments

    from koopman_lqr_controller.training.experiments.results import collect_comparison

    problem = find_task(task)
    sees = {method: METHODS[method] for method in methods}
    if problem.settings.crop:  # the others learn from vectors
        sees = {method: each for method, each in sees.items() if each.learner == "koopman"}
    if not sees:
        raise KoopmanError(f"--methods {' '.join(methods)}: learns from vectors, {task} shows pictures")
    runs = {}
    for method, each in sees.items():
        settings = tuple(sorted(dict((*each.changes, *changes)).items()))
        consolidation = options.consolidation if method == "koopman" else 0
        words = given_words(options, _WORDS)
        words += ["--learner", each.learner] if each.learner != "koopman" else []
        words += ["--set", *(f"{key}={value}" for key, value in settings)] if settings else []
        words += ["--consolidation", str(consolidation)] if consolidation != CONSOLIDATION else []
        runs[method] = options.learning_runs(task, settings, words, consolidation, each.learner)
    # If `--set` makes two methods identical, they share one run.
    named = {each[seed].name: each[seed] for seed in range(options.seeds) for each in runs.values()}
    everything = list(named.values())
    found = run_experiments(everything, options.run_options(problem), options.workers, task, options.ray)
    by_name: dict[str, dict[str, Any]] = {run.name: result for run, result in zip(everything, found, strict=True)}
    results = {method: [by_name[run.name] for run in each] for method, each in runs.items()}
    rows, figures = collect_comparison(name, task, results)
    print(as_table(rows, {}))
    experiment = f"koopman_{name.replace('-', '_')}_{task}"
    file = options.results / f"{experiment}.json"
    write_results(file, experiment, range(options.seeds), rows, figures)
    print(f"results    {file}")


def _draw(options: Plot) -> int:
    from koopman_lqr_controller.training.experiments.plots import draw  # matplotlib is not installed on robots

    for file in options.results:
        picture = options.output / f"{file.stem}.svg"
        draw(file, picture)
        print(f"picture    {picture}")
    return 0


compare = make_command("compare", Compare, _compare, _EPILOG)
plot = make_command("plot", Plot, _draw)
comparison_figures = make_old_command("comparison_figures", "plot", plot)

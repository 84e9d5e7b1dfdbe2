"""The commands `compare` and `comparison_figures`: the tables and figures of thesis 4.3, under one budget each."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ctrl_rl_core.command import folder_to_write, run_command
from ctrl_rl_core.io.results import write_results

from koopman_lqr_controller.cli.run_options import (
    CONSOLIDATION,
    add_learning_options,
    as_command,
    check_learning_options,
    given_words,
)
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.environments.benchmark_tasks import find_task
from koopman_lqr_controller.training.experiments.comparisons import COMPARISONS
from koopman_lqr_controller.training.experiments.methods import METHODS, Changes

_WORDS = ("chunks", "actions", "episodes", "device")
_LIST = "\n".join(
    f"  {name:<12} {each.about}: {', '.join(each.tasks)}\n{'':15}methods {', '.join(each.methods)}"
    for name, each in COMPARISONS.items()
)


def compare(arguments: Sequence[str] | None = None) -> int:
    """Learn with all methods of a table or figure of thesis 4.3, each with the same budget, and set them side by side.

    Runs that another comparison, or `learn`, has left in the folder are taken, not learnt again.
    """
    parser = argparse.ArgumentParser(
        prog="compare",
        description=compare.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=f"comparisons:\n{_LIST}\n\nThe same command goes on where an earlier one was cut off.\n\nexample:\n"
        "  compare --table 4.4 --tasks cartpole_swingup --seeds 3",
    )
    what = parser.add_mutually_exclusive_group(required=True)
    for kind in ("table", "figure"):
        numbers = [name.partition("-")[2] for name in COMPARISONS if name.startswith(kind)]
        what.add_argument(f"--{kind}", choices=numbers, help=f"of the thesis: {', '.join(numbers)}", metavar="NUMBER")
    parser.add_argument("--tasks", nargs="+", metavar="TASK", help="default: all that the thesis compares on")
    parser.add_argument("--methods", nargs="+", metavar="METHOD", help="only these of the methods below")
    parser.add_argument(
        "--results", type=folder_to_write, default=Path("docs/results"), help="folder (default %(default)s)"
    )
    add_learning_options(parser, seeds=3)
    options = parser.parse_args(arguments)
    return run_command("compare", lambda: _compare(options, given_words(parser, options, _WORDS)))


def comparison_figures(arguments: Sequence[str] | None = None) -> int:
    """Draw the curves of learning (thesis Fig. 4.3, 4.8, 4.9) from results that `compare` wrote."""
    parser = argparse.ArgumentParser(prog="comparison_figures", description=comparison_figures.__doc__)
    parser.add_argument("results", nargs="+", type=Path, help="JSON files of `compare`")
    parser.add_argument(
        "--output", type=folder_to_write, default=Path("docs/images"), help="folder (default %(default)s)"
    )
    options = parser.parse_args(arguments)
    return run_command("comparison_figures", lambda: _draw(options))


def _compare(options: argparse.Namespace, words: Sequence[str]) -> int:
    changes = check_learning_options(options)
    name = f"table-{options.table}" if options.table else f"figure-{options.figure}"
    comparison = COMPARISONS[name]
    tasks, methods = options.tasks or comparison.tasks, tuple(options.methods or comparison.methods)
    for method in methods:
        if method not in comparison.methods:
            raise KoopmanError(f"--methods {method}: {name} is of {', '.join(comparison.methods)}")
    for task in tasks:
        if task not in comparison.tasks:
            raise KoopmanError(f"--tasks {task}: {name} is of {', '.join(comparison.tasks)}")
        for method in methods:
            find_task(task).with_settings(**dict((*METHODS[method].changes, *changes)))  # refuses before torch is here
    for task in tasks:
        _compare_on(task, name, methods, changes, options, words)
    return 0


def _compare_on(
    task: str, name: str, methods: Sequence[str], changes: Changes, options: argparse.Namespace, words: Sequence[str]
) -> None:
    from ctrl_rl_training.experiments.matrix import run_experiments
    from ctrl_rl_training.experiments.results import as_table
    from ctrl_rl_training.experiments.run import RunOptions

    from koopman_lqr_controller.training.experiments.comparison_results import collect_comparison
    from koopman_lqr_controller.training.experiments.runs import LearningRun

    problem = find_task(task)
    sees = {method: METHODS[method] for method in methods}
    if problem.settings.crop:  # the others learn from vectors
        sees = {method: each for method, each in sees.items() if each.learner == "koopman"}
    if not sees:
        raise KoopmanError(f"--methods {' '.join(methods)}: learns from vectors, {task} shows pictures")
    runs: dict[str, list[LearningRun]] = {}
    for method, each in sees.items():
        settings = tuple(sorted(dict((*each.changes, *changes)).items()))
        consolidation = options.consolidation if method == "koopman" else 0
        said = ["learn", "--task", task, *words]
        said += ["--learner", each.learner] if each.learner != "koopman" else []
        said += ["--set", *(f"{key}={value}" for key, value in settings)] if settings else []
        said += ["--consolidation", str(consolidation)] if consolidation != CONSOLIDATION else []
        runs[method] = [
            LearningRun(
                task,
                seed,
                settings,
                options.device,
                as_command(*said, "--seeds", str(seed + 1)),
                consolidation,
                each.learner,
            )
            for seed in range(options.seeds)
        ]
    how = RunOptions(
        options.folder,
        options.chunks or problem.chunks,
        options.actions or problem.chunk,
        problem.evaluations,
        options.episodes,
    )
    # Where `--set` makes two methods the same, they are one run.
    named = {each[seed].name: each[seed] for seed in range(options.seeds) for each in runs.values()}
    everything = list(named.values())
    found = run_experiments(everything, how, options.workers, task, options.ray)
    by_name: dict[str, dict[str, Any]] = {run.name: result for run, result in zip(everything, found, strict=True)}
    results = {method: [by_name[run.name] for run in each] for method, each in runs.items()}
    rows, figures = collect_comparison(name, task, results)
    print(as_table(rows, {}))
    experiment = f"koopman_{name.replace('-', '_')}_{task}"
    file = options.results / f"{experiment}.json"
    write_results(file, experiment, range(options.seeds), rows, figures)
    print(f"results    {file}")


def _draw(options: argparse.Namespace) -> int:
    from ctrl_rl_training.experiments.results import read_figures

    from koopman_lqr_controller.training.experiments.plots import (  # matplotlib is not for robots
        Comparison,
        draw_comparison,
    )

    options.output.mkdir(parents=True, exist_ok=True)
    for file in options.results:
        figures = read_figures(file, Comparison)
        picture = options.output / f"{file.stem}.png"
        draw_comparison(figures, picture)
        print(f"picture    {picture}")
    return 0

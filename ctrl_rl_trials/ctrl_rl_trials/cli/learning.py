"""The commands `train` and `plot`: compare all ways on the ladder with the same networks, samples and seeds."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ctrl_rl_core.command import FolderToWrite, OptionalFileToWrite
from ctrl_rl_core.tasks import require, with_grid
from ctrl_rl_learning.study import (
    ITERATION,
    ExperimentOptions,
    PlotOptions,
    Positive,
    RunOptions,
    make_command,
    one_of,
    some_of,
)

from ctrl_rl_trials.ladder.task_list import LADDER, load_ladder_task
from ctrl_rl_trials.shaping.variants import BY_DEFAULT, LEARNERS, WAYS

_EVALUATIONS, _FINAL_EVALUATIONS = 20, 10


@dataclass(frozen=True, kw_only=True)
class Train(ExperimentOptions):
    """Train on tasks with each way of using a value function, from several seeds, resuming an interrupted call.

    Policies train in the planar engine and are tested in PyBullet. After Ctrl-C the command still prints the table of
    the finished runs and writes its results.
    """

    folder: FolderToWrite = Path("runs/ladder")
    """Folder of the runs; each run has its own subfolder and resumes there."""
    samples: Positive = 10 * ITERATION
    """Samples per run, rounded up to iterations of 10240."""
    tasks: tuple[str, ...] = LADDER
    """Tasks: names from the ladder or the suite, or task files."""
    ways: Annotated[tuple[str, ...], some_of(WAYS)] = BY_DEFAULT
    """Ways to use the time to reach, or none; best_progress_mpc solves trajectories first, in minutes per task."""
    learners: Annotated[tuple[str, ...], some_of(LEARNERS)] = LEARNERS
    """Learners."""
    results: OptionalFileToWrite = None
    """JSON file to write the table and curves to; it keeps the data of other methods."""


@dataclass(frozen=True, kw_only=True)
class Plot(PlotOptions):
    """Draw the success rate over samples for each task, from the results that `train` wrote."""

    learner: Annotated[str, one_of(LEARNERS)] = "ppo"
    """Learner whose runs to draw."""


def _train(options: Train) -> int:
    tasks = {name: load_ladder_task(name) for name in options.tasks or LADDER}
    for task in tasks.values():
        require("ctrl_rl_trials train", task)
    # Torch takes seconds to import: wait until the arguments are valid.
    from ctrl_rl_learning.study import run_experiments

    from ctrl_rl_trials.ladder.results import as_table, collect, read_curves, write
    from ctrl_rl_trials.ladder.runs import ladder_runs
    from ctrl_rl_trials.shaping.time_to_go import find_or_solve_trajectories
    from ttr_reward_node import find_or_solve

    def tell(line: str) -> None:
        print(line)

    if options.results is not None:
        read_curves(options.results)  # Fail now, not after days, if the results file cannot be extended.
    folder = options.folder / "values"
    values = {name: find_or_solve(task, folder, tell, with_grid(task)) for name, task in tasks.items()}
    ways, learners = options.ways or BY_DEFAULT, options.learners or LEARNERS
    workers = options.workers or os.cpu_count() or 1
    mpc_values = {
        name: find_or_solve_trajectories(task, folder, workers)
        for name, task in tasks.items()
        if any(WAYS[way].needs_mpc for way in ways)
    }
    runs = ladder_runs(list(tasks), ways, learners, options.seeds, values, mpc_values)
    how = RunOptions(options.folder, -(-options.samples // ITERATION), ITERATION, _EVALUATIONS, _FINAL_EVALUATIONS)
    try:
        run_experiments(runs, how, options.workers, "ladder", options.ray)
    finally:
        rows, curves = collect(runs, options.folder)
        if rows:
            print(as_table(rows))
        if rows and options.results is not None:
            write(options.results, options.seeds, rows, curves)
            print(f"results    {options.results}")
    return 0


def _plot(options: Plot) -> int:
    from ctrl_rl_learning.study import read_figures

    from ctrl_rl_trials.ladder.plots import draw_ladder
    from ctrl_rl_trials.ladder.results import LadderFigures

    for picture in draw_ladder(read_figures(options.results, LadderFigures), options.learner, options.output):
        print(f"picture    {picture}")
    return 0


train = make_command("train", Train, _train)
plot = make_command("plot", Plot, _plot)

"""The commands `train` and `plot`: learning with every baseline, and its figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ctrl_rl_core.command import FolderToWrite
from ctrl_rl_core.old_names import note_old_name
from ctrl_rl_core.tasks import require
from ctrl_rl_learning.study import (
    SimulatedOptions,
    TaskPlotOptions,
    make_command,
    make_old_command,
    read_training,
    some_of,
    train_and_collect,
)

from ctrl_rl_core import CommandError, load_navigation_task
from oc_baseline_node.training.experiments.methods import GROUPS, METHODS

_MAIN = ("oc_ppo", "ppo", "oc_corrected")


@dataclass(frozen=True, kw_only=True)
class Train(SimulatedOptions):
    """Learn a task's sparse reward with policy gradients, from several seeds; interrupted runs are resumed."""

    folder: FolderToWrite = Path("runs/oc_training")
    """Folder of the runs; each run has a subfolder, from which it is resumed."""
    methods: Annotated[tuple[str, ...], some_of(METHODS)] = ()
    """Methods to train; by default oc_ppo ppo oc_corrected."""
    compare: Annotated[tuple[str, ...], some_of([*GROUPS, "all"])] = ()
    """Figures or tables of the thesis whose methods to train, instead of --methods."""
    value: Path | None = None
    """Network of V_oc written by `oc fit`; by default the shipped one."""


@dataclass(frozen=True, kw_only=True)
class Plot(TaskPlotOptions):
    """Draw success, return, advantages and paths (thesis Fig. 3.9 to 3.16) from the results written by `train`."""


def _train(options: Train) -> int:
    if options.methods and options.compare:
        raise CommandError("give --methods or --compare, not both")
    if options.iterations:
        note_old_name("train", "--iterations", "--samples")
    task = load_navigation_task(options.task)
    require("oc_baseline_node train", task)
    from oc_baseline_node.training.experiments.results import LABELS, collect
    from oc_baseline_node.training.experiments.runs import oc_runs

    groups = GROUPS if "all" in options.compare else options.compare
    methods = options.methods or tuple(dict.fromkeys(name for group in groups for name in GROUPS[group])) or _MAIN
    runs = oc_runs(task, methods, options.seeds, options.value, options.engine)
    for run in runs:
        run.description  # noqa: B018 - refuses a missing or wrong V_oc before workers start
    train_and_collect(options, task, runs, "oc_training", collect, options.run_options(), LABELS)
    return 0


def _figures(options: TaskPlotOptions) -> int:
    from oc_baseline_node.training.plots import Learning, draw_all  # matplotlib is not installed on robots

    figures, task = read_training(options, Learning)
    for picture in draw_all(figures, task, options.output):
        print(f"picture    {picture}")
    return 0


train = make_command("train", Train, _train)
plot = make_command("plot", Plot, _figures)
training_figures = make_old_command("training_figures", "plot", plot)

"""The commands `train` and `plot`: training with every reward, and figures of the results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ctrl_rl_core.command import FolderToWrite
from ctrl_rl_core.old_names import note_old_name
from ctrl_rl_core.tasks import require
from ctrl_rl_learning.sb3 import ALGORITHMS, THESIS_ALGORITHMS
from ctrl_rl_learning.study import (
    SimulatedOptions,
    TaskPlotOptions,
    make_command,
    make_old_command,
    read_training,
    some_of,
    train_and_collect,
)

from ctrl_rl_core import ResultsError, load_navigation_task
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.rewards.rewards import PROGRESS, TRAINING_REWARDS


@dataclass(frozen=True, kw_only=True)
class Train(SimulatedOptions):
    """Train policies on a task with several rewards, algorithms and seeds; resume interrupted runs."""

    folder: FolderToWrite = Path("runs/ttr_training")
    """Folder with one subfolder per run; interrupted runs resume from it."""
    grid: Path | None = None
    """Time-to-reach function of the task (.safetensors), for the rewards ttr_progress and ttr."""
    algorithms: Annotated[tuple[str, ...], some_of(ALGORITHMS)] = THESIS_ALGORITHMS
    """Algorithms to train with."""
    rewards: Annotated[tuple[str, ...], some_of(TRAINING_REWARDS)] = (PROGRESS,)
    """Rewards to train with (default: best progress in the time to reach)."""


@dataclass(frozen=True, kw_only=True)
class Plot(TaskPlotOptions):
    """Plot success, visited states and paths (thesis Fig. 3.4 to 3.7) from the results of `train`."""

    algorithm: str | None = None
    """Algorithm whose visited states and paths to plot (default: the first)."""


def _train(options: Train) -> int:
    if options.iterations:
        note_old_name("train", "--iterations", "--samples")
    require("ttr_reward_node train", load_navigation_task(options.task))
    rewards = options.rewards or (PROGRESS,)
    needing = [reward for reward in (PROGRESS, "ttr") if reward in rewards]
    if needing and options.grid is None:
        raise TimeToReachError(f"the reward {needing[0]} needs --grid: make it with `solve --task {options.task}`")
    # Importing torch takes seconds, so check the arguments first.
    from ttr_reward_node.training.results import collect
    from ttr_reward_node.training.training import reward_runs

    runs = reward_runs(
        options.task, options.algorithms or THESIS_ALGORITHMS, rewards, options.seeds, options.grid, options.engine
    )
    for run in {run.reward: run for run in runs}.values():
        run.environment().close()  # reports errors before the workers start
    train_and_collect(options, runs[0].task, runs, "ttr_training", collect, options.run_options())
    return 0


def _figures(options: Plot) -> int:
    from ttr_reward_node.training.plots import Learning, draw_all  # keep matplotlib off robots

    figures, task = read_training(options, Learning)
    there = list(dict.fromkeys(method.split(", ")[0] for method in figures["curves"]))
    algorithm = options.algorithm or there[0]
    if algorithm not in there:
        raise ResultsError(f"{options.results}: has no runs of {algorithm}, but of {', '.join(there)}")
    for picture in draw_all(figures, task, algorithm, options.output):
        print(f"picture    {picture}")
    return 0


train = make_command("train", Train, _train)
plot = make_command("plot", Plot, _figures)
training_figures = make_old_command("training_figures", "plot", plot)

"""The commands `hardness` and `page`: measure how hard tasks are, and draw all tasks of the ladder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from ctrl_rl_core.command import FolderToWrite, NotNegative, make_command
from ctrl_rl_core.tasks import require, with_grid

from ctrl_rl_trials.ladder.task_list import LADDER, PRACTICE, load_ladder_task


@dataclass(frozen=True)
class Hardness:
    """Print each task's optimal time, and how often an untrained Gaussian policy reaches the goal in 10,240 samples."""

    tasks: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[TASK ...]")] = ()
    """Names of tasks or task files (default: the ladder)."""
    values: FolderToWrite = Path("runs/ladder/values")
    """Folder of times to reach; a missing one is solved if the task has a grid."""
    seed: NotNegative = 0
    """Seed of starts and actions."""


@dataclass(frozen=True)
class Page:
    """Draw all tasks of the ladder, six per picture."""

    output: Path = Path("docs/images/ladder_tasks.png")
    """Picture to write; the next six tasks go to NAME_2 beside it."""


def _hardness(options: Hardness) -> int:
    tasks = [load_ladder_task(name) for name in options.tasks or (*LADDER, *PRACTICE)]
    for task in tasks:
        require("ctrl_rl_trials hardness", task)
    from ctrl_rl_trials.ladder.hardness import SAMPLES, measure_hardness
    from ttr_reward_node import find_or_solve, load_value

    def tell(line: str) -> None:
        print(line)

    for task in tasks:
        posed = with_grid(task)
        value = load_value(find_or_solve(task, options.values, tell, posed)) if posed.grid else None
        found = measure_hardness(task, value, seed=options.seed)
        optimal = "not known" if found.optimal is None else f"{found.optimal:.1f} s"
        print(
            f"{task.name:<18} optimal {optimal:>9}, limit {found.limit:.0f} s, untrained: {found.goals} goals in "
            f"{SAMPLES} samples ({sum(found.ended.values())} episodes)",
        )
        if found.unreachable:
            print(f"{'':<18} the goal is unreachable from {found.unreachable:.0%} of the starts")
    return 0


def _page(options: Page) -> int:
    from ctrl_rl_trials.ladder.plots import draw_pages

    for picture in draw_pages([load_ladder_task(name) for name in LADDER], options.output):
        print(f"picture    {picture}")
    return 0


hardness = make_command("hardness", Hardness, _hardness)
page = make_command("page", Page, _page)

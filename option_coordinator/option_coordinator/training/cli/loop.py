"""The command `loop`: play, record, learn from the bags alone, play again, compare."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ctrl_rl_core.command import FolderToWrite, OptionalFileToWrite, Positive, make_command
from ctrl_rl_core.io import as_lines

from ctrl_rl_core import CommandError, Result, write_results
from option_coordinator.environments.tasks import load_option_task


@dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """Close the loop: learn a policy from a careless script's bags, the next from all bags so far, and compare them.

    After Ctrl-C the next call continues where it stopped; the results then hold the runs so far.
    """

    tasks: tuple[str, ...] = ("tool_delivery",)
    """Team tasks: names from the suite, or task files."""
    seeds: Positive = 5
    """Number of seeds, counted from 0."""
    rounds: Positive = 3
    """Rounds after the script's."""
    episodes: Positive = 100
    """Episodes that each round records."""
    tests: Positive = 50
    """Evaluation episodes per round."""
    careless: float = 0.5
    """Probability that the script takes any legal option."""
    folder: FolderToWrite = Path("runs/options_loop")
    """Folder of the runs; each goes on there where it was cut off."""
    results: OptionalFileToWrite = None
    """JSON file to write return and success of each round to."""


def _loop(options: LoopOptions) -> int:
    if not 0.0 <= options.careless <= 1.0:
        raise CommandError(f"--careless must be a probability, 0 to 1, not {options.careless:g}")
    tasks = [load_option_task(task).name for task in options.tasks]
    from option_coordinator.training.experiments.closed_loop import LoopSettings, run_loop

    found: dict[str, list[list[dict[str, Any]]]] = {}
    try:
        for seed in range(options.seeds):
            for named, task in zip(options.tasks, tasks, strict=True):
                settings = LoopSettings(options.rounds, options.episodes, options.tests, options.careless, seed)
                run = f"{task}-s{seed}"
                rounds = run_loop(
                    named,
                    options.folder / run,
                    settings,
                    lambda line, run=run: print(f"{run}: {line}"),  # type: ignore[misc]
                )
                found.setdefault(task, []).append(rounds)
    finally:
        rows = _rows(found)
        print(as_lines(rows))
        if rows and options.results is not None:
            write_results(options.results, "options_loop", range(options.seeds), rows)
            print(f"results    {options.results}")
    return 0


def _rows(found: dict[str, list[list[dict[str, Any]]]]) -> list[Result]:
    """Return figures of each round, one number a seed."""
    rows = []
    for task, runs in found.items():
        for number in range(len(runs[0])):
            name = f"{task}: weighted imitation, round {number}" if number else f"{task}: careless script"
            for metric, key, unit in (
                ("return", "return", "1"),
                ("success", "terminated", "1"),
                ("steps", "steps", "1"),
            ):
                rows.append(Result(name, metric, unit, [float(rounds[number][key]) for rounds in runs]))
            if all("predicted" in rounds[number] for rounds in runs):  # runs of before there was a prediction have none
                predicted = [float(rounds[number]["predicted"]["mean"]) for rounds in runs]
                rows.append(Result(name, "predicted, discounted", "1", predicted))
                rows.append(Result(name, "called better", "1", [float(rounds[number]["better"]) for rounds in runs]))
    return rows


loop = make_command("loop", LoopOptions, _loop)

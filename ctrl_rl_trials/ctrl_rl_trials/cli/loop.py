"""The command `loop`: drive, record, relabel, learn from bags alone, evaluate offline, drive again, compare."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from ctrl_rl_core.command import (
    FolderToWrite,
    NotNegative,
    OptionalFileToWrite,
    OptionalNotNegativeNumber,
    Positive,
    make_command,
    one_of,
    some_of,
)
from ctrl_rl_core.io import add_results, as_lines, digest
from ctrl_rl_core.tasks import require
from ctrl_rl_learning.offline import METHODS

from ctrl_rl_core import Result, load_navigation_task, task_digest

_ENGINES = ("planar", "auto", "pybullet", "mujoco")


@dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """Close the loop: learn a policy from a scripted driver's bags, the next from its own bags, and compare all rounds.

    After Ctrl-C the results hold the runs so far, and the same call resumes.
    """

    tasks: tuple[str, ...] = ("car_navigation",)
    """Tasks of the suite, or task files."""
    methods: Annotated[tuple[str, ...], some_of(METHODS)] = ("value_model",)
    """Learning methods."""
    seeds: Positive = 5
    """Number of seeds."""
    first_seed: NotNegative = 0
    """First of the seeds."""
    rounds: Positive = 3
    """Number of rounds after the scripted driver's round."""
    episodes: Positive = 150
    """Number of episodes recorded in each round."""
    tests: Positive = 100
    """Number of test episodes per policy."""
    updates: Positive = 5000
    """Number of updates of the networks."""
    clearance: OptionalNotNegativeNumber = None
    """Clearance to obstacles in the value function that teaches [m]; half the body's radius by default."""
    engine: Annotated[str, one_of(_ENGINES)] = "planar"
    """Physics engine."""
    folder: FolderToWrite = Path("runs/offline_loop")
    """Folder of the runs, which resume there."""
    results: OptionalFileToWrite = None
    """JSON file to add the success and return of each round to; the rows of other tasks and methods stay, and the
    values of other seeds with the same settings."""


def _loop(options: LoopOptions) -> int:
    tasks = {name: load_navigation_task(name) for name in options.tasks}
    for task in tasks.values():
        require("ctrl_rl_trials loop", task)
    from ctrl_rl_trials.offline.closed_loop import LoopSettings, run_loop

    found: dict[tuple[str, str, str], list[list[dict[str, Any]]]] = {}
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    try:
        for seed in seeds:
            for task in tasks.values():
                for method in options.methods:
                    settings = LoopSettings(
                        method,
                        rounds=options.rounds,
                        episodes=options.episodes,
                        tests=options.tests,
                        updates=options.updates,
                        engine=options.engine,
                        seed=seed,
                        clearance=options.clearance,
                    )
                    name = f"{task.name}-{method}-s{seed}"
                    rounds = run_loop(
                        task,
                        options.folder / name,
                        settings,
                        options.folder / "values",
                        lambda line, name=name: print(f"{name}: {line}"),  # type: ignore[misc]
                    )
                    terms = digest(asdict(settings) | {"seed": None, "task": task_digest(task)})[:16]
                    found.setdefault((task.name, method, terms), []).append(rounds)
    finally:
        if found:
            rows = _rows(found, options.first_seed)
            print(as_lines(rows))
            if options.results is not None:
                add_results(options.results, "offline_loop", seeds, rows, same_metric=True)
                print(f"results    {options.results}")
    return 0


def _rows(found: dict[tuple[str, str, str], list[list[dict[str, Any]]]], first_seed: int) -> list[Result]:
    """Return rows with success and return of each round, one number per seed."""
    rows = []
    for (task, method, terms), runs in found.items():
        seeds = tuple(range(first_seed, first_seed + len(runs)))
        for number in range(len(runs[0])):
            name = f"{task}: {method}, round {number}" if number else f"{task}: scripted driver for {method}"
            here = [rounds[number] for rounds in runs]
            columns = {
                "success": [float(np.mean(each["success"])) for each in here],
                "return": [float(np.mean(each["returns"])) for each in here],
            }
            if number:
                columns["predicted"] = [float(each["predicted"]["mean"]) for each in here]
                columns["called better"] = [float(each["better"]) for each in here]
            rows += [Result(name, metric, "1", values, None, seeds, terms) for metric, values in columns.items()]
    return rows


loop = make_command("loop", LoopOptions, _loop)

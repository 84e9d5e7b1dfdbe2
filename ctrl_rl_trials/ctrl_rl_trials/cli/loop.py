"""The command `loop`: drive, record, relabel, learn from bags alone, evaluate offline, drive again, compare."""

from __future__ import annotations

from dataclasses import dataclass
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
from ctrl_rl_core.io import as_lines
from ctrl_rl_core.tasks import require
from ctrl_rl_learning.offline import METHODS

from ctrl_rl_core import Result, load_navigation_task, write_results

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
    """JSON file to write the success and return of each round to."""


def _loop(options: LoopOptions) -> int:
    tasks = {name: load_navigation_task(name) for name in options.tasks}
    for task in tasks.values():
        require("ctrl_rl_trials loop", task)
    from ctrl_rl_trials.offline.closed_loop import LoopSettings, run_loop

    found: dict[tuple[str, str], list[list[dict[str, Any]]]] = {}
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
                    found.setdefault((task.name, method), []).append(rounds)
    finally:
        if found:
            rows = _rows(found)
            print(as_lines(rows))
            if options.results is not None:
                write_results(options.results, "offline_loop", seeds, rows)
                print(f"results    {options.results}")
    return 0


def _rows(found: dict[tuple[str, str], list[list[dict[str, Any]]]]) -> list[Result]:
    """Return rows with success and return of each round, one number per seed."""
    rows = []
    for (task, method), runs in found.items():
        for number in range(len(runs[0])):
            name = f"{task}: {method}, round {number}" if number else f"{task}: scripted driver for {method}"
            here = [rounds[number] for rounds in runs]
            rows.append(Result(name, "success", "1", [float(np.mean(each["success"])) for each in here]))
            rows.append(Result(name, "return", "1", [float(np.mean(each["returns"])) for each in here]))
            if number:
                rows.append(Result(name, "predicted", "1", [float(each["predicted"]["mean"]) for each in here]))
                rows.append(Result(name, "called better", "1", [float(each["better"]) for each in here]))
    return rows


loop = make_command("loop", LoopOptions, _loop)

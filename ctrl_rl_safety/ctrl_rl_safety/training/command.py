"""The command `train`: policies learnt with or without the filter, and attackers learnt against it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from ctrl_rl_core.command import FolderToWrite
from ctrl_rl_learning.study import ExperimentOptions, Positive, RunOptions, make_command, some_of

from ctrl_rl_core import Result, write_results

_ITERATION = 2048
_EVALUATIONS, _FINAL_EVALUATIONS = 10, 50
_CHECK_SEED = 3_000_000
_WAYS = ("none", "raw", "sent", "penalty")
_ROBOTS = ("turtlebot3_burger", "turtlebot2")


@dataclass(frozen=True, kw_only=True)
class Train(ExperimentOptions):
    """Train `car_navigation` by PPO with and without the filter as a shield, and evaluate all policies both ways.

    With `--attackers`, train policies that try to cause contacts, with or without the filter. All training uses the
    planar engine; an interrupted call resumes where it stopped.
    """

    folder: FolderToWrite = Path("runs/safety_shield")
    """Folder of the runs; each run has a subfolder, from which it is resumed."""
    samples: Positive = 10 * _ITERATION
    """Samples of a run, rounded to whole iterations of 2048."""
    ways: Annotated[tuple[str, ...], some_of(_WAYS)] = _WAYS
    """Treatment of corrections: no shield (none), or the learner receives its own action (raw), the action sent (sent),
    or its own action with a lower reward (penalty)."""
    attackers: Annotated[tuple[str, ...], some_of(_ROBOTS)] = ()
    """Robots for which to train attackers, in place of the comparison."""
    bare: bool = False
    """Train attackers without the filter, where contacts are possible."""


def _train(options: Train) -> int:
    # Importing torch takes seconds, so arguments are validated first.
    from ctrl_rl_learning.study import run_experiments

    from ctrl_rl_safety.training.runs import WAYS, AttackRun, ShieldRun

    how = RunOptions(options.folder, -(-options.samples // _ITERATION), _ITERATION, _EVALUATIONS, _FINAL_EVALUATIONS)
    seeds = range(options.seeds)
    if options.attackers:
        attacks = [AttackRun(robot, seed, options.bare) for seed in seeds for robot in options.attackers]
        for run, result in zip(attacks, run_experiments(attacks, how, options.workers, "attackers"), strict=True):
            print(f"{run.name}: avoidable contacts in {result['success']:.1%} of episodes")
        return 0
    runs = [ShieldRun("car_navigation", way, seed) for way in WAYS for seed in seeds if way in options.ways]
    results = run_experiments(runs, how, options.workers, "shield", options.ray)
    rows, figures = collect(runs, results, options.folder)
    for row in rows:
        print(f"{row.method:<16} {row.metric:<34} {np.mean(row.values):.4g}")
    if options.results is not None:
        write_results(options.results, "safety_shield", seeds, rows, {"task": "car_navigation", **figures})
        print(f"results    {options.results}")
    return 0


def collect(runs: Sequence[Any], results: Sequence[Any], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the rows of all runs with one value per seed, and the success curves by method.

    Args:
        runs: Runs of `ShieldRun`.
        results: Results of the runs.
        folder: Folder of the runs, which contains the policies.
    """
    from ctrl_rl_learning.sb3 import SUCCESS, evaluate
    from ctrl_rl_learning.study import curves_of, samples_to

    from ctrl_rl_core import Actor

    found: dict[str, dict[str, list[float]]] = {}
    finished: dict[str, list[Any]] = {}
    for run, result in zip(runs, results, strict=True):
        figures = found.setdefault(run.method, {})
        finished.setdefault(run.method, []).append((run, result))
        actor = Actor.load(folder / run.name / "policy.safetensors")
        for active, words in ((False, "without"), (True, "with")):
            environment = run.checked(active)
            ended = [each.outcome for each in evaluate(actor, environment, _FINAL_EVALUATIONS, _CHECK_SEED)]
            environment.close()
            for name, outcome in (("success", SUCCESS), ("collisions", "COLLISION")):
                figures.setdefault(f"{name} {words} the filter", []).append(ended.count(outcome) / len(ended))
        contacts = sum(point["ended"].get("COLLISION", 0) for point in result["curve"])
        figures.setdefault("collisions while learning", []).append(float(contacts))
        reached = samples_to(result["curve"], "evaluation", 0.9)
        if reached is not None:
            figures.setdefault("samples to 90 %", []).append(reached)
        figures.setdefault("seeds that reach 90 %", []).append(float(reached is not None))
    rows = [Result(method, name, "1", values) for method, figures in found.items() for name, values in figures.items()]
    return rows, {"curves": curves_of(finished, success="evaluation")}


train = make_command("train", Train, _train)

"""The command `shift_study`: fine-tune a policy from one engine on another engine's robot with delayed commands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from ctrl_rl_core.command import (
    FiniteNumber,
    FolderToWrite,
    OptionalFileToWrite,
    Positive,
    make_command,
    one_of,
    some_of,
)
from ctrl_rl_core.io import as_lines

from ctrl_rl_core import Result, write_results
from ctrl_rl_trials.errors import TrialError

_TASKS = ("car_ttr", "car_navigation")
_ENGINES = ("mujoco", "pybullet", "planar")
METHODS = {"motion": ("--motion",), "plain": ()}
NAMES = {"motion": "motion observed", "plain": "observation of its file"}


@dataclass(frozen=True, kw_only=True)
class ShiftStudy:
    """Fine-tune a shipped policy, trained in PyBullet, on a robot in MuJoCo with delayed commands.

    The command drives the robot through ROS alone, behind the safety filter, which knows the delay. An interrupted call
    resumes after the last complete episode, and the results hold the seeds so far.
    """

    task: Annotated[str, one_of(_TASKS)] = "car_ttr"
    """Task, which is also the name of its policy."""
    engine: Annotated[str, one_of(_ENGINES)] = "mujoco"
    """Physics engine of the robot."""
    delay: FiniteNumber = 0.7
    """Time from a command to its effect on the shifted robot [s]."""
    minutes: FiniteNumber = 30.0
    """Driving time of the fine-tuning [min]."""
    tests: Positive = 50
    """Number of test episodes."""
    seeds: Positive = 3
    """Number of seeds."""
    methods: Annotated[tuple[str, ...], some_of(METHODS)] = ("motion",)
    """Observation of the policy: as in its file (plain), or with speeds and last command added (motion)."""
    folder: FolderToWrite = Path("runs/shift_study")
    """Folder of the runs, which resume there."""
    results: OptionalFileToWrite = None
    """JSON file to write the success before and after fine-tuning to."""


def _study(options: ShiftStudy) -> int:
    if not 0.0 <= options.delay <= 2.0:
        raise TrialError("--delay must be 0 to 2 s")
    from ctrl_rl_trials.transfer.stage import Stage

    common = ("--tests", str(options.tests), "--values", str(options.folder / "values"))

    def success(name: str, delay: float, *words: str) -> dict[str, Any]:
        stage = Stage(options.folder / name, options.task, options.task, options.engine, delay, (*common, *words))
        found = dict(stage.run())
        print(f"{name}: success {found['success']:.3f}")
        return found

    nominal = success("nominal", 0.0, "--minutes", "0.0")
    before = success("before", options.delay, "--minutes", "0.0")
    tuned: dict[str, list[dict[str, Any]]] = {}
    try:
        for method in options.methods:
            for seed in range(options.seeds):
                words = ("--minutes", str(options.minutes), "--seed", str(seed), *METHODS[method])
                found = success(f"{method}-s{seed}", options.delay, *words)
                tuned.setdefault(method, []).append(found)
    finally:
        rows = _rows(options, nominal, before, tuned)
        print(as_lines(rows))
        if options.results is not None:
            done = range(max(map(len, tuned.values()), default=0))
            write_results(options.results, "robot_learning", done, rows)
            print(f"results    {options.results}")
    return 0


def _rows(
    options: ShiftStudy,
    nominal: dict[str, Any],
    before: dict[str, Any],
    tuned: dict[str, list[dict[str, Any]]],
) -> list[Result]:
    """Return rows with each stage's success, absolute and relative to the nominal robot; one number per tuned seed."""
    late = f"{options.task}, {options.engine}, commands {options.delay:g} s late"
    stages = {f"{options.task}, {options.engine}, nominal": [nominal], late: [before]}
    stages |= {f"{late}, after {options.minutes:g} min, {NAMES[method]}": found for method, found in tuned.items()}
    rows = []
    for method, found in stages.items():
        wins = [float(each["success"]) for each in found]
        rows.append(Result(method, "success", "1", wins))
        if nominal["success"]:
            rows.append(Result(method, "success over nominal", "1", [each / nominal["success"] for each in wins]))
        times = [
            float(np.mean([test["seconds"] for test in each["tests"] if test["outcome"] == "GOAL"] or [np.nan]))
            for each in found
        ]
        rows.append(Result(method, "time to the goal", "s", times))
        collisions = [float(sum(test["outcome"] == "COLLISION" for test in each["tests"])) for each in found]
        rows.append(Result(method, "collisions in tests", "1", collisions))
        if any(each["episodes"] for each in found):
            hits = [float(sum(one["outcome"] == "COLLISION" for one in each["episodes"])) for each in found]
            rows.append(Result(method, "collisions while learning", "1", hits))
            rows.append(Result(method, "robot's time", "min", [each["seconds"] / 60.0 for each in found]))
            missed = [float(sum(one["missed"] for one in each["episodes"])) for each in found]
            rows.append(Result(method, "missed steps", "1", missed))
    return rows


shift_study = make_command("shift_study", ShiftStudy, _study)

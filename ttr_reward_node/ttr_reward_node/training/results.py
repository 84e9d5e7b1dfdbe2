"""Table of a task's runs over all rewards and algorithms, and the data of the figures.

rows, figures = collect(reward_runs("quad_ttr"), Path("runs/ttr_training"))
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_learning.sb3 import load_visits
from ctrl_rl_learning.study import collect_rows, curves_of, finished_runs, metric, metrics_of_speed, result_file
from numpy.typing import NDArray

from ctrl_rl_core import Result
from ttr_reward_node.training.training import RewardRun

THESIS_SAMPLES = {"quad_ttr": 90_000.0}
"""Number of samples after which the thesis's quadrotor reaches `GOOD` with the time-to-reach reward, by task."""
STAGES = 3
"""Number of phases of the training shown separately in Fig. 3.7."""


def collect(todo: Sequence[RewardRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the table and the figure data of all finished runs.

    Returns:
        For each algorithm and reward, the success of the last evaluation and the samples to `GOOD`, one value per seed
        (seeds that never reach it are excluded and counted); and `curves`, `visits` and `paths` by method.
    """
    found = finished_runs(todo, folder, lambda run: f"{run.algorithm}, {run.reward}")
    metrics = [metric("success", "1", lambda result: result["success"]), *metrics_of_speed()]
    figures = {
        "seeds": {method: [run.seed for run, _ in runs] for method, runs in found.items()},
        "curves": curves_of(found, success="evaluation"),
        "visits": {method: _visits(folder, [run for run, _ in runs]) for method, runs in found.items()},
        "paths": {method: runs[0][1]["paths"] for method, runs in found.items()},
    }
    return collect_rows(found, metrics, _thesis), figures


def _thesis(run: RewardRun, name: str) -> float | None:
    return THESIS_SAMPLES.get(run.task.name) if run.reward == "ttr" and name.startswith("samples") else None


def _visits(folder: Path, runs: Sequence[RewardRun]) -> dict[str, list[Any]]:
    """Return visit counts of states in each third of the training, summed over seeds, by position and angle."""
    places: list[NDArray[np.int64]] = []
    turns: list[NDArray[np.int64]] = []
    for run in runs:
        counts = load_visits(result_file(folder, run).with_name("visits.safetensors"))
        places.append(_stages(counts["places"]))
        turns.append(_stages(counts["turns"]))
    return {"places": np.sum(places, axis=0).tolist(), "turns": np.sum(turns, axis=0).tolist()}


def _stages(counts: NDArray[Any]) -> NDArray[np.int64]:
    parts = np.array_split(counts.astype(np.int64), STAGES)
    return np.array([part.sum(axis=0) for part in parts])

"""What the runs of a task amount to: the table of all rewards and algorithms, and what the figures are drawn from.

rows, figures = collect(reward_runs("quad_ttr"), Path("runs/ttr_training"))
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.io.results import Result
from ctrl_rl_training.experiments.results import GOOD, curves, finished_runs, samples_to
from ctrl_rl_training.experiments.run_folder import result_file
from ctrl_rl_training.sb3.state_visitation import load_visits
from numpy.typing import NDArray

from ttr_reward_node.training.training import RewardRun

THESIS_SAMPLES = {"quad_ttr": 90_000.0}
"""After how many samples the thesis's quadrotor is that good with the time-to-reach reward."""
STAGES = 3
"""Parts of the training that Fig. 3.7 shows one by one."""
Finished = list[tuple[RewardRun, dict[str, Any]]]


def collect(todo: Sequence[RewardRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the table and the figures' data of all runs that are finished.

    Returns:
        For each algorithm and reward the success of the last evaluation and the samples to `GOOD`, one value a seed
        (seeds that never get there are left out and counted); and `curves`, `visits` and `paths` by method.
    """
    runs = finished_runs(todo, folder, lambda run: f"{run.algorithm}, {run.reward}")
    rows: list[Result] = []
    for method, finished in runs.items():
        results = [result for _, result in finished]
        rows.append(Result(method, "success", "1", [result["success"] for result in results]))
        learnt = [samples for result in results if (samples := samples_to(result["curve"])) is not None]
        rows.append(Result(method, f"seeds that reach {GOOD:.0%}", "1", [float(len(learnt))], None))
        if learnt:
            thesis = THESIS_SAMPLES.get(finished[0][0].task.name) if finished[0][0].reward == "ttr" else None
            rows.append(Result(method, f"samples to {GOOD:.0%}", "1", learnt, thesis))
    figures = {
        "seeds": {method: [run.seed for run, _ in finished] for method, finished in runs.items()},
        "curves": {
            method: curves([result for _, result in finished], success="evaluation")
            for method, finished in runs.items()
        },
        "visits": {method: _visits(folder, finished) for method, finished in runs.items()},
        "paths": {method: _paths([result for _, result in finished]) for method, finished in runs.items()},
    }
    return rows, figures


def success_table(rows: Sequence[Result]) -> str:
    """Return the success of each algorithm and reward as text, one value a seed."""
    return "\n".join(
        f"{row.method:<22} success {' '.join(f'{100 * value:4.0f}' for value in row.values)} %"
        for row in rows
        if row.metric == "success"
    )


def _visits(folder: Path, finished: Finished) -> dict[str, list[Any]]:
    """How often states were met in each third of the training, all seeds together: places and angles."""
    places: list[NDArray[np.int64]] = []
    turns: list[NDArray[np.int64]] = []
    for run, _ in finished:
        counts = load_visits(result_file(folder, run).with_name("visits.safetensors"))
        places.append(_stages(counts["places"]))
        turns.append(_stages(counts["turns"]))
    return {"places": np.sum(places, axis=0).tolist(), "turns": np.sum(turns, axis=0).tolist()}


def _stages(counts: NDArray[Any]) -> NDArray[np.int64]:
    parts = np.array_split(counts.astype(np.int64), STAGES)
    return np.array([part.sum(axis=0) for part in parts])


def _paths(results: Sequence[dict[str, Any]]) -> list[Any]:
    """Return the first seed's paths, those of an evaluation after learning."""
    paths: list[Any] = results[0]["paths"]
    return paths

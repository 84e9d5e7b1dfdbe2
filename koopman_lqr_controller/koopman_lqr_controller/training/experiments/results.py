"""What the runs of a task amount to: one table with the thesis's figures beside ours, and curves to draw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from ctrl_rl_core.io.results import Result

from koopman_lqr_controller.training.environments.benchmark_tasks import BenchmarkTask

_LEARNT, _CONSOLIDATED = "task-oriented Koopman", "task-oriented Koopman, consolidated"


def collect(problem: BenchmarkTask, results: Sequence[dict[str, Any]]) -> tuple[list[Result], dict[str, Any]]:
    """Return the table of all runs of a problem, one value a seed, and the curves as JSON."""
    learner = results[0]["run"]["learner"]
    rows = _learnt(_LEARNT if learner == "koopman" else learner, problem, results)
    if all(result["consolidated"] for result in results):
        rows += _consolidated(results)
    curves = {"steps": [[point["steps"] for point in result["curve"]] for result in results]}
    for name in results[0]["curve"][0]["returns"]:
        curves[name] = [[point["returns"][name] for point in result["curve"]] for result in results]
    return rows, {"task": problem.name, "curves": curves}


def _learnt(method: str, problem: BenchmarkTask, results: Sequence[dict[str, Any]]) -> list[Result]:
    rows = [
        Result(method, "return", "1", [float(np.mean(result["returns"])) for result in results], problem.thesis),
        Result(method, "actions to the best", "1", [float(result["best"]["actions"]) for result in results]),
        Result(method, "time", "min", [sum(p["seconds"] for p in result["curve"]) / 60 for result in results]),
        Result(method, "CPU time", "min", [result["cpu_seconds"] / 60 for result in results]),
    ]
    for unit in ("episodes", "actions"):
        for what in ("learning", "choosing"):
            counts = [float(result["interaction"][what][unit]) for result in results]
            rows.append(Result(method, f"{unit} for {what}", "1", counts))
    return rows + _goals(method, results)


def _consolidated(results: Sequence[dict[str, Any]]) -> list[Result]:
    ends = [result["consolidated"] for result in results]
    rows = [
        Result(_CONSOLIDATED, "return", "1", [float(np.mean(end["returns"])) for end in ends]),
        Result(_CONSOLIDATED, "latent dimensions", "1", [float(end["latent"]) for end in ends]),
        Result(_CONSOLIDATED, "Riccati residual", "1", [end["dare_residual"] for end in ends]),
    ]
    rows += [
        Result(_CONSOLIDATED, f"{unit} more", "1", [float(end["interaction"][unit]) for end in ends])
        for unit in ("episodes", "actions")
    ]
    for method, figures in ((_LEARNT, [end["learnt"] for end in ends]), (_CONSOLIDATED, ends)):
        rows.append(Result(method, "spectral radius of A - B K", "1", [each["spectral_radius"] for each in figures]))
        errors = [each["error_over_persistence"] for each in figures]
        rows.append(Result(method, "one-step error over persistence, noisy episodes", "1", errors))
        rows.append(Result(method, "the same of K z", "1", [each["law_error"] for each in figures]))
    return rows + _goals(_CONSOLIDATED, ends)


def _goals(method: str, figures: Sequence[dict[str, Any]]) -> list[Result]:
    """Return how often the goal was reached, where episodes say how they end."""
    if not any(each["outcomes"] for each in figures):
        return []
    parts = [each["outcomes"].get("GOAL", 0) / max(1, sum(each["outcomes"].values())) for each in figures]
    return [Result(method, "goal reached", "1", parts)]

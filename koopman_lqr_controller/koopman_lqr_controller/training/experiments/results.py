"""Result tables of a task's or a comparison's runs with the thesis's values, and curves to draw."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import pairwise
from operator import getitem
from typing import Any

import numpy as np
from ctrl_rl_core.io import digest
from ctrl_rl_learning.study import Metric, collect_rows, metric

from ctrl_rl_core import Result
from koopman_lqr_controller.training.environments.task import BenchmarkTask
from koopman_lqr_controller.training.experiments.comparisons import COMPARISONS, LEVELS, REFERENCE
from koopman_lqr_controller.training.experiments.last_curves import shown_return
from koopman_lqr_controller.training.experiments.methods import METHODS

Results = Sequence[Mapping[str, Any]]
"""Results of `train`, one per seed."""
FRAMES = (100_000, 200_000, 350_000)
"""Numbers of simulated frames at which others publish returns."""
_LEARNT, _CONSOLIDATED = "task-oriented Koopman", "task-oriented Koopman, consolidated"


def _at(*path: str) -> Callable[[Mapping[str, Any]], float]:
    """Return a function that looks up a value in a result."""
    return lambda result: float(reduce(getitem, path, result))  # type: ignore[arg-type]


def _where_there(name: str) -> Callable[[Results], list[float]]:
    """Return a function that looks up a value in all results, if all have it."""
    return lambda results: [each[name] for each in results] if all(name in each for each in results) else []


def _goals(results: Results) -> list[float]:
    """Return how often the goal was reached, if episodes report their outcome."""
    ended = [each["outcomes"] for each in results]
    return [each.get("GOAL", 0) / max(1, sum(each.values())) for each in ended] if any(ended) else []


def _mean_return(result: Mapping[str, Any]) -> float:
    return float(np.mean(result["returns"]))


_RETURN = metric("return", "1", _mean_return)
_TO_THE_BEST = metric("actions to the best", "1", _at("best", "actions"))
_CPU_TIME = metric("CPU time", "min", lambda result: result["cpu_seconds"] / 60)
_GOALS = Metric("goal reached", "1", _goals)
_LEARNING = (
    _RETURN,
    _TO_THE_BEST,
    metric("time", "min", lambda result: sum(point["seconds"] for point in result["curve"]) / 60),
    _CPU_TIME,
    *(
        metric(f"{unit} for {what}", "1", _at("interaction", what, unit))
        for unit in ("episodes", "actions")
        for what in ("learning", "choosing")
    ),
    _GOALS,
)
_CONSOLIDATING = (
    _RETURN,
    metric("latent dimensions", "1", _at("latent")),
    metric("Riccati residual", "1", _at("dare_residual")),
    *(metric(f"{unit} more", "1", _at("interaction", unit)) for unit in ("episodes", "actions")),
)
_BOTH = (
    metric("spectral radius of A - B K", "1", _at("spectral_radius")),
    metric("one-step error over persistence, noisy episodes", "1", _at("error_over_persistence")),
    metric("the same of K z", "1", _at("law_error")),
)
_FINAL = (
    _RETURN,
    Metric("model error", "1", _where_there("model_error")),
    Metric("one-step error over persistence", "1", _where_there("error_over_persistence")),
    _TO_THE_BEST,
    _CPU_TIME,
)


def _rows(
    method: str, results: Results, metrics: Sequence[Metric], thesis: Mapping[str, float | None] | None = None
) -> list[Result]:
    finished: Any = {method: [(None, result) for result in results]}
    return collect_rows(finished, metrics, lambda _, name: (thesis or {}).get(name))


def collect(problem: BenchmarkTask, results: Sequence[dict[str, Any]]) -> tuple[list[Result], dict[str, Any]]:
    """Return the table of all runs of a problem, one value per seed, and the curves as JSON."""
    learner = results[0]["run"]["learner"]
    rows = _rows(_LEARNT if learner == "koopman" else learner, results, _LEARNING, {"return": problem.thesis})
    if all(result["consolidated"] for result in results):
        ends = [result["consolidated"] for result in results]
        rows += _rows(_CONSOLIDATED, ends, _CONSOLIDATING)
        rows += _rows(_LEARNT, [end["learnt"] for end in ends], _BOTH)
        rows += _rows(_CONSOLIDATED, ends, (*_BOTH, _GOALS))
    curves = {"steps": [[point["steps"] for point in result["curve"]] for result in results]}
    for name in results[0]["curve"][0]["returns"]:
        curves[name] = [[point["returns"][name] for point in result["curve"]] for result in results]
    return rows, {"task": problem.name, "curves": curves}


def collect_last(problem: BenchmarkTask, results: Results) -> list[Result]:
    """Return the rows of runs that kept their last policy, by task: returns after all training frames.

    Returns at intermediate `FRAMES` are those of the policy at that time, in the episodes of that evaluation. Frames
    used by consolidation are counted separately. Rows name their seeds and terms, so that a results file can merge them
    with those of seeds trained elsewhere.
    """
    last, title = results[0]["curve"][-1]["steps"], problem.title
    passed = [(number, at["steps"]) for number, at in enumerate(results[0]["curve"]) if at["steps"] in FRAMES]
    then = [metric(_at_frames(frames), "1", _shown_after(number)) for number, frames in passed if frames != last]
    returned = metric(_at_frames(last), "1", _mean_return)
    rows = _rows(title, results, (*then, returned))
    if all(result["consolidated"] for result in results):
        more = metric(
            f"frames more, after {last / 1000:g}k", "1", lambda end: end["interaction"]["actions"] * problem.repeat
        )
        rows += _rows(f"{title}, consolidated", [result["consolidated"] for result in results], (returned, more))
    seeds = tuple(result["run"]["seed"] for result in results)
    return [replace(row, seeds=seeds, terms=_terms(results[0])) for row in rows]


def _terms(result: Mapping[str, Any]) -> str:
    """Return the digest of a run's settings except its seed."""
    return digest({**result["run"], "seed": None})[:16]


def _shown_after(number: int) -> Callable[[Mapping[str, Any]], float]:
    """Return a function that looks up the return shown in curves after a number of chunks."""
    return lambda result: shown_return(result["curve"][number])


def _at_frames(frames: int) -> str:
    return f"return at {frames / 1000:g}k frames"


def collect_comparison(name: str, task: str, results: Mapping[str, Results]) -> tuple[list[Result], dict[str, Any]]:
    """Return the rows of a comparison and its figure data.

    Args:
        name: One of `COMPARISONS`.
        task: Task of the runs.
        results: Results by method.

    Returns:
        Rows, and `comparison`, `kind`, `task`, `reference` and, by method, `curves`: `samples`, simulation steps
            (chunks,), and `values`, evaluation returns (seeds, chunks); a run that ended early keeps its last value.
    """
    comparison, rows = COMPARISONS[name], list[Result]()
    if comparison.kind == "levels":
        rows += [row for method in results for row in _levels(method, comparison.levels, results[method])]
    for method, each in results.items():
        thesis = dict(zip(("return", "model error"), comparison.thesis.get((task, method), ()), strict=False))
        rows += _rows(METHODS[method].label, each, _FINAL, thesis)
    figures = {
        "comparison": name,
        "kind": comparison.kind,
        "task": task,
        "reference": REFERENCE.get(task),
        "curves": {method: _curves(each) for method, each in results.items()},
    }
    return rows, figures


def _levels(method: str, levels: Sequence[float], results: Results) -> list[Result]:
    """Return, for each level of model error, the best evaluation return of a run at that level."""
    rows: list[Result] = []
    found: list[tuple[float, list[float]]] = []

    def add(level: float, name: str, unit: str, values: list[float], thesis: float | None) -> None:
        rows.append(Result(f"{METHODS[method].label}, model error ~{level:.0e}", name, unit, values, thesis))

    for level in levels:
        values = [best for result in results if (best := _best_at(level, result["curve"])) is not None]
        if values:
            found.append((level, values))
            add(level, "return at this model error", "1", values, LEVELS.get((method, level)))
    for (before, better), (level, values) in pairwise(found):
        thesis = [LEVELS.get((method, each)) for each in (before, level)]
        lost = None if thesis[0] is None or thesis[1] is None else 100.0 * (1.0 - thesis[1] / thesis[0])
        ours = 100.0 * (1.0 - float(np.mean(values)) / float(np.mean(better))) if np.mean(better) else 0.0
        add(level, "less than at the level before", "%", [ours], lost)
    return rows


def _best_at(level: float, curve: Sequence[Mapping[str, Any]]) -> float | None:
    """Return the best return of the candidates with a model error of this order of magnitude, or None."""
    returns = [
        point["returns"][name]
        for point in curve
        for name, error in point["model_errors"].items()
        if error > 0.0 and round(math.log10(error)) == round(math.log10(level))
    ]
    return max(returns, default=None)


def _curves(results: Results) -> dict[str, list[Any]]:
    curves = [result["curve"] for result in results]
    longest = max(curves, key=len)
    values = [[shown_return(point) for point in curve] for curve in curves]
    return {
        "samples": [point["steps"] for point in longest],
        "values": [each + [each[-1]] * (len(longest) - len(each)) for each in values],
    }

"""Training figures drawn from results: success (thesis Fig. 3.4, 3.6) and visited states (Fig. 3.7)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from ctrl_rl_core.io import Schema
from ctrl_rl_core.plots import (
    GOAL,
    Panel,
    Style,
    best_of,
    draw_counts,
    draw_learning,
    draw_map,
    draw_paths,
    legend_below,
    line_of,
    picture,
    style_of,
)
from ctrl_rl_core.tasks import ANGLES
from ctrl_rl_learning.study import DrivenPath, Figures, SuccessCurve
from pydantic import Field, model_validator

from ctrl_rl_core import NavigationTask, ResultsError
from ttr_reward_node.rewards.rewards import PROGRESS
from ttr_reward_node.training.results import STAGES

_FILES = {"success": "svg", "visits": "png", "turns": "svg", "paths": "png"}
_DRAWN = (PROGRESS, "ttr", "distance_10", "distance_0", "sparse")
"""Rewards shown in figures; the tables contain all."""
_LABELS = {
    PROGRESS: "progress of time to reach",
    "sparse": "sparse",
    "distance_0": "distance, λ = 0",
    "distance_0.1": "distance, λ = 0.1",
    "distance_1": "distance, λ = 1",
    "distance_10": "distance, λ = 10",
    "ttr": "time to reach",
}
_Row = Annotated[list[int], Field(min_length=1, max_length=1000)]
_Rows = Annotated[list[_Row], Field(min_length=1, max_length=1000)]


class Visited(Schema):
    """Visit counts of states in each third of the training, see `results.collect`."""

    places: Annotated[list[_Rows], Field(min_length=STAGES, max_length=STAGES)]
    turns: Annotated[list[_Row], Field(min_length=STAGES, max_length=STAGES)]

    @model_validator(mode="after")
    def _rectangular(self) -> Visited:
        if any(len({len(row) for row in rows}) > 1 for rows in self.places):
            raise ValueError("places: rows of different lengths")
        if min(map(min, self.turns)) < 0 or min(min(map(min, rows)) for rows in self.places) < 0:
            raise ValueError("a count below zero")
        return self


class Learning(Figures):
    """Data of the training figures, see `results.collect`."""

    seeds: Annotated[dict[str, Annotated[list[int], Field(max_length=100_000)]], Field(min_length=1)]
    curves: Annotated[dict[str, SuccessCurve], Field(min_length=1, max_length=100)]
    visits: dict[str, Visited]
    paths: dict[str, Annotated[list[DrivenPath], Field(max_length=1000)]]


_THIRDS = ("first third", "second third", "last third")


def draw_all(figures: Mapping[str, Any], task: NavigationTask, algorithm: str, folder: Path) -> Iterator[Path]:
    """Plot success, visited states and paths, and yield the files; paths are omitted if there are none."""
    files = {part: folder / f"{task.name}_{part}.{kind}" for part, kind in _FILES.items()}
    draw_curves(figures, files["success"])
    draw_visits(figures, task, algorithm, files["visits"])
    draw_turns(figures, task, algorithm, files["turns"])
    best = PROGRESS if f"{algorithm}, {PROGRESS}" in figures["paths"] else "ttr"
    paths = figures["paths"].get(f"{algorithm}, {best}")
    if paths:
        title = f"{task.name}: paths after learning with {algorithm.upper()}"
        draw_paths(files["paths"], title, task, {f"reward: {_LABELS[best]}": paths})
    else:
        files.pop("paths")
    yield from files.values()


def draw_curves(figures: Mapping[str, Any], path: Path) -> None:
    """Plot success over training samples, one panel per algorithm."""
    curves: Mapping[str, Any] = figures["curves"]
    algorithms = list(dict.fromkeys(method.split(", ")[0] for method in curves))
    panels = [
        Panel(
            algorithm.upper(),
            [
                line_of(reward, _LABELS[reward], curves[f"{algorithm}, {reward}"], "success")
                for reward in _DRAWN
                if f"{algorithm}, {reward}" in curves
            ],
        )
        for algorithm in algorithms
    ]
    told = "; ".join(f"{panel.title}: {best_of(panel.lines)}" for panel in panels[:1])
    draw_learning(path, f"{figures['task']}, {told}", panels)


def draw_visits(figures: Mapping[str, Any], task: NavigationTask, algorithm: str, path: Path) -> None:
    """Plot the positions visited in each third of the training, with and without the time to reach (Fig. 3.7)."""
    rewards = _compared(figures, algorithm)
    # The darkest colour is the most visited position of any third.
    most = max(np.max(figures["visits"][f"{algorithm}, {reward}"]["places"]) for reward in rewards)
    (_, width), (_, height) = task.plane_bounds.items()
    with picture(path, f"{task.name}, {algorithm.upper()}: where it was while it learnt", len(rewards), STAGES,
                 height=1.0 + 1.75 * len(rewards), sharex=True, sharey=True) as (figure, axes):  # fmt: skip
        for row, reward in zip(axes, rewards, strict=True):
            visits = figures["visits"][f"{algorithm}, {reward}"]
            for ax, counts, stage in zip(row, visits["places"], _THIRDS, strict=True):
                places = np.array(counts, dtype=float).T
                x = np.linspace(*width, places.shape[1] + 1)
                y = np.linspace(*height, places.shape[0] + 1)
                image = draw_counts(ax, x, y, places, float(most))
                draw_map(ax, task)
                ax.set_title(f"{_LABELS[reward]}: {stage}")
                ax.label_outer()
        figure.colorbar(image, ax=list(axes.flat), label="steps in a cell", shrink=0.8)


def draw_turns(figures: Mapping[str, Any], task: NavigationTask, algorithm: str, path: Path) -> None:
    """Plot the angles visited in each third of the training, with and without the time to reach."""
    angle = next(name for name in task.system.build().state_names if name in ANGLES)
    target = task.goal.region.intervals.get(angle)
    with picture(path, f"{task.name}, {algorithm.upper()}: angles met while learning", 1, STAGES, height=2.6,
                 sharex=True, sharey=True) as (figure, axes):  # fmt: skip
        taken: dict[str, Style] = {}
        for stage, ax in enumerate(axes[0]):
            for reward in _compared(figures, algorithm):
                taken.setdefault(reward, style_of(reward, taken))
                turns = np.array(figures["visits"][f"{algorithm}, {reward}"]["turns"][stage], dtype=float)
                edges = np.linspace(-180.0, 180.0, len(turns) + 1)
                density = 100.0 * turns / max(turns.sum(), 1.0) / (edges[1] - edges[0])
                look = taken[reward]
                ax.stairs(density, edges, color=look.colour, linestyle=look.line, label=_LABELS[reward])
            if target is not None:
                low, high = np.rad2deg((target.low, target.high))
                ax.axvspan(low, high, facecolor="none", edgecolor=GOAL, hatch="//", label="goal")
            ax.set_title(_THIRDS[stage])
            ax.set_xlabel(f"{angle} [°]")
            ax.set_xticks([-180, 0, 180])
            ax.set_yscale("log")
            ax.set_ylim(bottom=1e-3)
        axes[0, 0].set_ylabel("share of steps [%/°]")
        legend_below(figure)


def _compared(figures: Mapping[str, Any], algorithm: str) -> list[str]:
    """Return the time-to-reach reward and the sparse reward, as far as runs with them exist."""
    ours = PROGRESS if f"{algorithm}, {PROGRESS}" in figures["visits"] else "ttr"
    found = [reward for reward in (ours, "sparse") if f"{algorithm}, {reward}" in figures["visits"]]
    if not found:
        raise ResultsError(f"there are no visits of {algorithm} with {PROGRESS}, ttr or sparse to draw")
    return found

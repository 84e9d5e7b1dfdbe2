"""Pictures of learning, drawn from results: success (thesis Fig. 3.4, 3.6) and visits (Fig. 3.7)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from ctrl_rl_core.io.schema import Schema
from ctrl_rl_core.tasks.regions import ANGLES
from ctrl_rl_training.experiments.figure_data import DrivenPath, Figures, SuccessCurve
from ctrl_rl_training.plots import draw_curve, over_seeds
from matplotlib import pyplot as plt
from pydantic import Field, model_validator

from ctrl_rl_core import NavigationTask, ResultsError, draw_world, position_indices, save_figure
from ttr_reward_node.rewards.rewards import PROGRESS, TRAINING_REWARDS
from ttr_reward_node.training.results import STAGES

_COLOURS = dict(
    zip(
        TRAINING_REWARDS,
        ("tab:green", "0.45", "tab:blue", "tab:cyan", "tab:purple", "tab:orange", "tab:red"),
        strict=True,
    )
)
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
    """How often states were met in each third of the training, see `results.collect`."""

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
    """What is drawn of learning, see `results.collect`."""

    seeds: Annotated[dict[str, Annotated[list[int], Field(max_length=100_000)]], Field(min_length=1)]
    curves: Annotated[dict[str, SuccessCurve], Field(min_length=1, max_length=100)]
    visits: dict[str, Visited]
    paths: dict[str, Annotated[list[DrivenPath], Field(max_length=1000)]]


_COMPARED = ("sparse", "distance_10", "ttr", PROGRESS)
"""Rewards of Fig. 3.7, and progress."""


def draw_curves(figures: Mapping[str, Any], path: Path) -> None:
    """Draw success against samples, a panel for each algorithm: mean and standard deviation over the seeds."""
    curves: Mapping[str, Any] = figures["curves"]
    algorithms = list(dict.fromkeys(method.split(", ")[0] for method in curves))
    figure, axes = plt.subplots(
        1, len(algorithms), figsize=(4.2 * len(algorithms), 3.6), sharey=True, squeeze=False, layout="constrained"
    )
    for algorithm, ax in zip(algorithms, axes[0], strict=True):
        for reward in TRAINING_REWARDS:
            curve = curves.get(f"{algorithm}, {reward}")
            if curve is not None:
                width = 2.2 if reward in (PROGRESS, "ttr") else 1.3
                draw_curve(ax, curve["samples"], curve["success"], _LABELS[reward], _COLOURS[reward], width)
        ax.set_title(algorithm.upper())
        ax.set_xlabel("samples [thousands]")
        ax.set_ylim(-0.02, 1.02)
        ax.grid(alpha=0.3)
    axes[0, 0].set_ylabel("success rate")
    axes[0, -1].legend(fontsize=8)
    seeds = max(len(seeds) for seeds in figures["seeds"].values())
    figure.suptitle(f"{figures['task']}: success while learning, {over_seeds(seeds)}")
    save_figure(figure, path)


def draw_visits(figures: Mapping[str, Any], task: NavigationTask, algorithm: str, path: Path) -> None:
    """Draw which states learning met in each third of the training: where, and at which angle, as Fig. 3.7 does."""
    rewards = [reward for reward in _COMPARED if f"{algorithm}, {reward}" in figures["visits"]]
    if not rewards:
        raise ResultsError(f"there are no visits of {algorithm} with {', '.join(_COMPARED)} to draw")
    figure, axes = plt.subplots(
        2, STAGES * len(rewards), figsize=(2.3 * STAGES * len(rewards), 4.6), squeeze=False, layout="constrained"
    )
    sides = list(task.plane_bounds.values())
    angle = next(name for name in task.system.build().state_names if name in ANGLES)
    target = task.goal.region.intervals.get(angle)
    names = [task.system.build().state_names[index] for index in position_indices(task.system.build().state_names)]
    for column, (reward, stage) in enumerate((reward, stage) for reward in rewards for stage in range(STAGES)):
        visits = figures["visits"][f"{algorithm}, {reward}"]
        turns = np.array(visits["turns"][stage], dtype=float)
        edges = np.linspace(-np.pi, np.pi, len(turns) + 1)
        density = turns / max(turns.sum(), 1.0) / (edges[1] - edges[0])
        above = axes[0, column]
        above.stairs(density, edges, fill=True, color=_COLOURS[reward], baseline=1e-4)
        above.set_yscale("log")
        above.set_ylim(1e-4, 10.0)
        if target is not None:
            above.axvspan(target.low, target.high, color="tab:green", alpha=0.25, linewidth=0)
        above.set_title(f"{_LABELS[reward]}\n{('first', 'second', 'last')[stage]} third", fontsize=8)
        below = axes[1, column]
        places = np.log1p(np.array(visits["places"][stage], dtype=float)).T
        extent = (sides[0].low, sides[0].high, sides[1].low, sides[1].high)
        below.imshow(places, origin="lower", extent=extent, cmap="magma_r", aspect="auto")
        draw_world(below, task)
        below.set_xlim(sides[0])
        below.set_ylim(sides[1])
        above.set_xlabel(f"{angle} [rad]", fontsize=7)
        for ax in (above, below):
            ax.tick_params(labelsize=6, labelleft=column == 0)
    axes[0, 0].set_ylabel(f"density of {angle}")
    axes[1, 0].set_ylabel(f"{names[1]} over {names[0]} [m]")
    figure.suptitle(f"{figures['task']}, {algorithm.upper()}: states met while learning")
    save_figure(figure, path)

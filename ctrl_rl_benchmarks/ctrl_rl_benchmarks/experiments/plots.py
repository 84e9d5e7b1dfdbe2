"""The figure of the ladder: success over samples, a panel for each task, a line for each way."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from ctrl_rl_training.experiments.figure_data import Figures, SuccessCurve
from ctrl_rl_training.plots import draw_curve
from matplotlib import pyplot as plt
from pydantic import Field

from ctrl_rl_benchmarks.ways.methods import MAIN, WAYS
from ctrl_rl_core import save_figure

_COLUMNS = 5
_COLOURS = dict(
    zip(
        MAIN,
        ("tab:red", "0.45", "tab:blue", "tab:orange", "tab:cyan", "tab:purple", "tab:brown", "tab:green"),
        strict=True,
    )
)


class LadderFigures(Figures):
    """What is drawn of the ladder, see `results.collect`."""

    curves: Annotated[dict[str, SuccessCurve], Field(min_length=1, max_length=2000)]


def draw_ladder(figures: Mapping[str, Any], learner: str, path: Path) -> None:
    """Draw the success of the main ways with a learner on each task; mean and standard deviation over the seeds."""
    curves: Mapping[str, Any] = figures["curves"]
    tasks = list(dict.fromkeys(name.split(": ")[0] for name in curves if name.endswith(f", {learner}")))
    rows = -(-len(tasks) // _COLUMNS)
    figure, axes = plt.subplots(
        rows, _COLUMNS, figsize=(3.0 * _COLUMNS, 2.6 * rows), squeeze=False, sharey=True, layout="constrained"
    )
    for ax in axes.flat[len(tasks) :]:
        ax.axis("off")
    for ax, task in zip(axes.flat, tasks, strict=False):
        for way, colour in _COLOURS.items():
            curve = curves.get(f"{task}: {way}, {learner}")
            if curve is not None:
                width = 2.2 if way == MAIN[0] else 1.2
                draw_curve(ax, curve["samples"], curve["success"], WAYS[way].label, colour, width, band=way == MAIN[0])
        ax.set_title(task.replace("_", " "), fontsize=9)
        ax.set_ylim(-0.03, 1.03)
        ax.grid(alpha=0.3)
        ax.tick_params(labelsize=7)
    handles = {label: line for ax in axes.flat for line, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), fontsize=8, loc="outside lower center", ncols=4)
    figure.suptitle(f"success over thousands of samples, {learner.upper()}", fontsize=10)
    save_figure(figure, path)

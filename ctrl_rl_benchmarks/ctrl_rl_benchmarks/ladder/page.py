"""All tasks of the ladder on one page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import Rectangle

from ctrl_rl_core import NavigationTask, draw_map, save_figure

_COLUMNS = 4


def draw_page(tasks: Sequence[NavigationTask], path: Path) -> None:
    """Draw worlds, starts (orange), goals (green) and traps (red) of tasks side by side."""
    rows = -(-len(tasks) // _COLUMNS)
    figure, axes = plt.subplots(
        rows, _COLUMNS, figsize=(3.2 * _COLUMNS, 3.2 * rows), squeeze=False, layout="constrained"
    )
    for ax in axes.flat[len(tasks) :]:
        ax.axis("off")
    for ax, task in zip(axes.flat, tasks, strict=False):
        draw_map(ax, task)
        for region, colour in ((task.start, "tab:orange"), (task.trap, "tab:red")):
            if region is None:
                continue
            (x, width), (y, height) = [
                (region.intervals[name].low, region.intervals[name].length) for name in ("x", task.plane[1])
            ]
            ax.add_patch(Rectangle((x, y), width, height, color=colour, alpha=0.5, linewidth=0))
            ax.plot(x + 0.5 * width, y + 0.5 * height, marker="o", markersize=3, color=colour)
        if "theta" in task.start.intervals:
            middle = task.start.intervals["theta"].centre
            place = [task.start.intervals[name].centre for name in ("x", "y")]
            ax.annotate(
                "",
                (place[0] + 0.6 * np.cos(middle), place[1] + 0.6 * np.sin(middle)),
                place,
                arrowprops={"arrowstyle": "->", "color": "tab:orange"},
            )
        ax.set_title(task.name.replace("_", " "), fontsize=10)
        ax.tick_params(labelsize=6)
        ax.set_xlabel("")
        ax.set_ylabel("")
    save_figure(figure, path)

"""The tasks of the ladder side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from ctrl_rl_core.plots import DANGER, draw_map, draw_robot, picture, word_at
from matplotlib.patches import Rectangle

from ctrl_rl_core import NavigationTask

_COLUMNS, _MOST = 3, 6


def draw_pages(tasks: Sequence[NavigationTask], path: Path) -> Iterator[Path]:
    """Draw worlds, starts, goals and traps of tasks, six a picture, and return the files."""
    for page, first in enumerate(range(0, len(tasks), _MOST), 1):
        file = path if page == 1 else path.with_stem(f"{path.stem}_{page}")
        _draw_page(tasks[first : first + _MOST], file)
        yield file


def _draw_page(shown: Sequence[NavigationTask], path: Path) -> None:
    rows = -(-len(shown) // _COLUMNS)
    sizes = np.max([[side.length for side in task.plane_bounds.values()] for task in shown], axis=0)
    with picture(path, "", rows, _COLUMNS, height=0.2 + 1.75 * rows) as (_, axes):
        for ax in axes.flat[len(shown) :]:
            ax.set_axis_off()
        for ax, task in zip(axes.flat, shown, strict=False):
            draw_map(ax, task)
            middle = [side.centre for side in task.plane_bounds.values()]
            ax.set_xlim(middle[0] - 0.5 * sizes[0], middle[0] + 0.5 * sizes[0])  # the same scale in all
            ax.set_ylim(middle[1] - 0.5 * sizes[1], middle[1] + 0.5 * sizes[1])
            ax.set_title(task.name.replace("_", " "))
            names = ("x", task.plane[1])
            place = tuple(task.start.intervals[name].centre for name in names)
            turn = task.start.intervals["theta"].centre if "theta" in task.start.intervals else 0.0
            draw_robot(ax, place, turn, task.robot.radius, flies=task.plane == "xz")
            word_at(ax, "start", (place[0], place[1]))
            if task.trap is not None:
                x, y = (task.trap.intervals[name] for name in names)
                ax.add_patch(Rectangle((x.low, y.low), x.length, y.length, color=DANGER, alpha=0.5, linewidth=0))
                word_at(ax, "trap", (x.centre, y.centre), DANGER)

"""Pictures of the ladder: its tasks, success rates during training, and the final success of all seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.plots import DANGER, Panel, draw_ends, draw_learning, draw_map, draw_robot, line_of, picture, word_at
from matplotlib.patches import Rectangle

from ctrl_rl_core import NavigationTask

_COMPARED = {
    "best_progress": "best progress",
    "best_progress_geodesic": "geodesic",
    "distance": "distance",
    "sparse": "sparse",
}
"""Ways that were trained on all tasks with the same seeds, by their names in the figure; tables show the others."""
_SEEDS = 3
"""Minimum number of seeds for a task to appear in the figure."""
_LEARNT = 0.9
"""Success rate from which a task counts as learnt."""


def draw_ladder(figures: Mapping[str, Any], learner: str, folder: Path) -> list[Path]:
    """Draw training curves and final success of the main ways with a learner; return the files."""
    curves = {
        tuple(name.removesuffix(f", {learner}").split(": ")): curve
        for name, curve in figures["curves"].items()
        if name.endswith(f", {learner}")
    }
    tasks = [
        task for (task, way), curve in curves.items() if way == "best_progress" and len(curve["success"]) >= _SEEDS
    ]
    compared = {way: name for way, name in _COMPARED.items() if any((task, way) in curves for task in tasks)}
    ends = {
        way: {_words(task): [100.0 * seed[-1] for seed in curves[task, way]["success"]] for task in tasks
              if (task, way) in curves} for way in compared
    }  # fmt: skip
    learnt = {way: sum(np.mean(seeds) >= 100.0 * _LEARNT for seeds in each.values()) for way, each in ends.items()}
    told = ", ".join(f"{name} {learnt[way]}" for way, name in compared.items())
    title = f"{learner.upper()} learns, of {len(tasks)} tasks: {told}"
    panels = [
        Panel(_words(task), [line_of(way, name, curves[task, way], "success") for way, name in compared.items()
                             if (task, way) in curves])
        for task in tasks
    ]  # fmt: skip
    out = [folder / f"ladder_{learner}.svg", folder / f"ladder_{learner}_ends.svg"]
    draw_learning(out[0], title, panels)
    draw_ends(out[1], title, ends, compared)
    return out


def _words(task: str) -> str:
    return task.replace("_", " ")


_COLUMNS, _MOST = 3, 6
_WALLS = 0.8
"""Room for the walls around a world, both sides together [m]."""


def draw_pages(tasks: Sequence[NavigationTask], path: Path) -> Iterator[Path]:
    """Draw worlds, starts, goals and traps of tasks, six per picture, and yield the files."""
    for page, first in enumerate(range(0, len(tasks), _MOST), 1):
        file = path if page == 1 else path.with_stem(f"{path.stem}_{page}")
        _draw_page(tasks[first : first + _MOST], file)
        yield file


def _draw_page(shown: Sequence[NavigationTask], path: Path) -> None:
    rows = -(-len(shown) // _COLUMNS)
    lengths = [(task.plane, [side.length + _WALLS for side in task.plane_bounds.values()]) for task in shown]
    with picture(path, "", rows, _COLUMNS, height=0.2 + 1.6 * rows, sharey="row") as (_, axes):
        for ax in axes.flat[len(shown) :]:
            ax.set_axis_off()
        for number, (ax, task) in enumerate(zip(axes.flat, shown, strict=False)):
            draw_map(ax, task)
            middle = [side.centre for side in task.plane_bounds.values()]
            sizes = np.max([each for plane, each in lengths if plane == task.plane], axis=0)
            ax.set_xlim(middle[0] - 0.5 * sizes[0], middle[0] + 0.5 * sizes[0])  # the same scale in all that look alike
            ax.set_ylim(middle[1] - 0.5 * sizes[1], middle[1] + 0.5 * sizes[1])
            below = shown[number + _COLUMNS : number + _COLUMNS + 1]
            if any(other.plane == task.plane for other in below):
                ax.set_xlabel("")
                ax.tick_params(labelbottom=False)
            if number % _COLUMNS:
                ax.set_ylabel("")
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

"""Draws a task's world with matplotlib: walls, obstacles, goal. Only pictures import this module."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path as FilePath
from typing import Any

import matplotlib as mpl
import numpy as np

from ctrl_rl_core.io.atomic_write import atomic_write

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon, Rectangle

from ctrl_rl_core.geometry.shapes import ArcPath, Box, Shape
from ctrl_rl_core.geometry.units import Interval
from ctrl_rl_core.tasks.task import NavigationTask

_GOAL: dict[str, Any] = {"color": "tab:green", "alpha": 0.3, "linewidth": 0, "label": "goal"}


def draw_world(axes: Axes, task: NavigationTask, width: float | None = None) -> None:
    """Draw walls, obstacles and goal in the task's plane [m].

    Args:
        axes: To draw on.
        task: Task whose world is drawn.
        width: Free width of its corridor [m]; None for the task's own.
    """
    world = task.build_world(width)
    for shape in (*world.walls, *world.obstacles):
        axes.add_patch(_solid(shape))
    for patch in _goal(task, world.path, world.width):
        axes.add_patch(patch)
    axes.set_aspect("equal")


def draw_map(axes: Axes, task: NavigationTask) -> None:
    """Draw the task's world, with axes [m] over the space within its walls."""
    draw_world(axes, task)
    (across, width), (up, height) = task.plane_bounds.items()
    axes.set_xlim(width)
    axes.set_ylim(height)
    axes.set_xlabel(f"{across} [m]")
    axes.set_ylabel(f"{up} [m]")


def save_figure(figure: Figure, path: FilePath, dpi: int = 110) -> None:
    """Write a figure as PNG, atomically, and close it."""
    picture = BytesIO()
    figure.savefig(picture, format="png", dpi=dpi)
    plt.close(figure)
    atomic_write(path, picture.getvalue())


def _solid(shape: Shape) -> Patch:
    if isinstance(shape, Box):
        corner = (shape.centre[0] - 0.5 * shape.size[0], shape.centre[1] - 0.5 * shape.size[1])
        angle = float(np.rad2deg(shape.angle))
        return Rectangle(corner, *shape.size, angle=angle, rotation_point="center", color="0.3", linewidth=0)
    return Circle(shape.centre, shape.radius, color="0.3", linewidth=0)


def _goal(task: NavigationTask, path: ArcPath | None, width: float | None) -> list[Patch]:
    goal = task.goal.region
    if path is not None and width is not None:
        return [_stretch(path, goal.intervals["s"], width)] if "s" in goal.intervals else []
    if goal.disc is not None:
        return [Circle(goal.disc.centre, goal.disc.radius, **_GOAL)]
    sides = [goal.intervals[name] for name in ("x", "y", "z") if name in goal.intervals]
    return (
        [Rectangle((sides[0].low, sides[1].low), *(side.length for side in sides), **_GOAL)] if len(sides) == 2 else []
    )


def _stretch(path: ArcPath, along: Interval, width: float) -> Polygon:
    """Return the part of a corridor between two arc lengths."""
    x, y, heading = path.pose(np.linspace(along.low, along.high, 30)).T
    sides = [np.column_stack((x - e * np.sin(heading), y + e * np.cos(heading))) for e in (0.5 * width, -0.5 * width)]
    return Polygon(np.vstack((sides[0], sides[1][::-1])), **_GOAL)

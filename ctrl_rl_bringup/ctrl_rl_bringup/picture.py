"""The picture of a drive: its path over the task's walls, and what happened over time."""

from __future__ import annotations

import os
from pathlib import Path as FilePath

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from ctrl_rl_core.geometry import Box, Path
from ctrl_rl_core.tasks import NavigationTask, load_navigation_task
from ctrl_rl_core.units import Interval
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle, Polygon, Rectangle
from matplotlib.transforms import Affine2D

from ctrl_rl_bringup.monitor import OUTCOMES
from ctrl_rl_bringup.report import Drive


def draw_drive(drive: Drive, path: FilePath) -> None:
    """Write the picture as a PNG; the file is there whole or not at all."""
    task = load_navigation_task(drive.task)
    figure, axes = plt.subplot_mosaic(
        [["map", "clearance"], ["map", "speed"], ["map", "turn"]],
        width_ratios=(1.5, 1),
        figsize=(12, 5),
        layout="constrained",
    )
    _draw_map(axes["map"], task, drive)
    _draw_over_time(axes, drive)
    figure.suptitle(f"{task.name}: {OUTCOMES[drive.outcome]} after {drive.duration:.1f} s", fontweight="bold")
    temporary = path.with_name(f".{path.name}")
    figure.savefig(temporary, format="png", dpi=110)
    plt.close(figure)
    os.replace(temporary, path)


def _draw_map(axes: Axes, task: NavigationTask, drive: Drive) -> None:
    world = task.build_world(drive.width)
    for shape in (*world.walls, *world.obstacles):
        axes.add_patch(_box(axes, shape) if isinstance(shape, Box) else Circle(shape.centre, shape.radius, color="0.3"))
    if world.path is not None and world.width is not None:
        axes.add_patch(_stretch(world.path, task.goal.intervals["s"], world.width))
    points = drive.truth[:, 1:3]
    if len(points) > 1:
        clearance = np.interp(drive.truth[:, 0], *drive.clearance.T)
        line = LineCollection(list(np.stack((points[:-1], points[1:]), axis=1)), cmap="viridis", linewidth=2.5)
        line.set_array(clearance[:-1])
        axes.add_collection(line)
        plt.colorbar(line, ax=axes, location="bottom", shrink=0.6, label="clearance [m]")
        axes.plot(*points[0], "o", color="black", label="start")
        _mark_times(axes, drive)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.autoscale_view()
    axes.legend(loc="best", frameon=False)


def _stretch(path: Path, along: Interval, width: float) -> Polygon:
    """Return the part of a corridor between two arc lengths."""
    x, y, heading = path.pose(np.linspace(along.low, along.high, 30)).T
    sides = [np.column_stack((x - e * np.sin(heading), y + e * np.cos(heading))) for e in (0.5 * width, -0.5 * width)]
    return Polygon(np.vstack((sides[0], sides[1][::-1])), color="tab:green", alpha=0.25, linewidth=0, label="goal")


def _mark_times(axes: Axes, drive: Drive, step: float = 5.0) -> None:
    """Write the time beside the path every few seconds."""
    for time in np.arange(step, drive.duration, step):
        x, y = (np.interp(time, drive.truth[:, 0], drive.truth[:, column]) for column in (1, 2))
        axes.plot(x, y, ".", color="black", markersize=4)
        axes.annotate(f"{time:g} s", (x, y), (4, 4), textcoords="offset points", fontsize=7)


def _box(axes: Axes, box: Box) -> Rectangle:
    corner = (box.centre[0] - 0.5 * box.size[0], box.centre[1] - 0.5 * box.size[1])
    turned = Affine2D().rotate_around(*box.centre, box.angle) + axes.transData
    return Rectangle(corner, *box.size, color="0.3", linewidth=0, transform=turned)


def _draw_over_time(axes: dict[str, Axes], drive: Drive) -> None:
    axes["clearance"].plot(*drive.clearance.T, color="tab:blue")
    axes["clearance"].axhline(0.0, color="tab:red", linewidth=1)
    axes["clearance"].set_ylabel("clearance [m]")
    axes["speed"].step(drive.commands[:, 0], drive.commands[:, 1], where="post", color="tab:green")
    axes["speed"].set_ylabel("speed [m/s]")
    axes["turn"].step(drive.commands[:, 0], drive.commands[:, 2], where="post", color="tab:orange")
    axes["turn"].set(xlabel="time [s]", ylabel="turn rate [rad/s]")
    for name in ("clearance", "speed", "turn"):
        axes[name].grid(alpha=0.3)
        axes[name].set_xlim(0.0, max(drive.duration, 1e-3))

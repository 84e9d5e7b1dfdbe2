"""The picture of a drive: its path over the task's walls, and what happened over time."""

from __future__ import annotations

import os
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from ctrl_rl_core.geometry import Box
from ctrl_rl_core.tasks import NavigationTask, load_navigation_task
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle, Rectangle
from matplotlib.transforms import Affine2D

from ctrl_rl_bringup.monitor import OUTCOMES
from ctrl_rl_bringup.report import Drive


def draw_drive(drive: Drive, path: Path) -> None:
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
    if world.path is not None:
        goal = task.goal.intervals["s"]
        end = world.path.pose(np.linspace(goal.low, goal.high, 20))
        axes.plot(end[:, 0], end[:, 1], color="tab:green", linewidth=14, alpha=0.35, label="goal")
    points = drive.truth[:, 1:3]
    if len(points) > 1:
        clearance = np.interp(drive.truth[:, 0], *drive.clearance.T)
        line = LineCollection(list(np.stack((points[:-1], points[1:]), axis=1)), cmap="viridis", linewidth=2.5)
        line.set_array(clearance[:-1])
        axes.add_collection(line)
        plt.colorbar(line, ax=axes, location="bottom", shrink=0.6, label="clearance [m]")
        axes.plot(*points[0], "o", color="black", label="start")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.autoscale_view()
    axes.legend(loc="best", frameon=False)


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

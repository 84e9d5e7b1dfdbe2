"""The picture of a drive: its path over the task's walls, and what happened over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle

from ctrl_rl_bringup.corridor.report import DriveReport
from ctrl_rl_bringup.runner.monitor import OUTCOMES
from ctrl_rl_core import NavigationTask, draw_world, load_navigation_task, save_figure

_COMMANDS = {"xy": ("speed\n[m/s]", "turn rate\n[rad/s]"), "xz": ("$T_1$\n[N]", "$T_2$\n[N]")}
"""Labels of the two commands by the plane of the task."""


def draw_drive(drive: DriveReport, path: Path) -> None:
    """Write the picture as a PNG; the file is there whole or not at all."""
    task = load_navigation_task(drive.task)
    rows = ["clearance", "speed", "turn"]
    rows += ["reach"] if len(drive.rewards) else []
    rows += ["value"] if len(drive.oc_values) else []
    rows += ["error"] if len(drive.predictions) else []
    figure, axes = plt.subplot_mosaic(
        [["map", row] for row in rows],
        width_ratios=(1.5, 1),
        figsize=(12, 6),
        layout="constrained",
    )
    _draw_map(axes["map"], task, drive)
    _draw_over_time(axes, drive, _COMMANDS[task.plane])
    for row in rows:
        axes[row].grid(alpha=0.3)
        axes[row].set_xlim(0.0, max(drive.duration, 1e-3))
    axes[rows[-1]].set_xlabel("time [s]")
    figure.suptitle(f"{task.name}: {OUTCOMES[drive.outcome]} after {drive.duration:.1f} s", fontweight="bold")
    save_figure(figure, path)


def _draw_map(axes: Axes, task: NavigationTask, drive: DriveReport) -> None:
    draw_world(axes, task, drive.width)
    points = drive.truth[:, 1:3]
    if len(points) > 1:
        clearance = np.interp(drive.truth[:, 0], *drive.clearance.T)
        line = LineCollection(list(np.stack((points[:-1], points[1:]), axis=1)), cmap="viridis", linewidth=2.5)
        line.set_array(clearance[:-1])
        axes.add_collection(line)
        plt.colorbar(line, ax=axes, location="bottom", shrink=0.6, label="clearance [m]")
        axes.plot(*points[0], "o", color="black", label="start")
        _mark_times(axes, drive)
    _draw_movers(axes, drive)
    axes.set(xlabel="x [m]", ylabel=f"{task.plane[1]} [m]")
    axes.autoscale_view()
    axes.legend(loc="best", frameon=False)


def _draw_movers(axes: Axes, drive: DriveReport) -> None:
    """Draw where the moving obstacles went, and where they were at the end."""
    for mover in drive.movers:
        driven = mover.track[mover.track[:, 0] <= drive.duration]
        axes.plot(*driven[:, 1:].T, ":", color="tab:red", linewidth=1)
        axes.add_patch(Circle(mover.at(drive.duration), mover.radius, color="tab:red", alpha=0.6, linewidth=0))


def _mark_times(axes: Axes, drive: DriveReport, step: float = 5.0) -> None:
    """Write the time beside the path every few seconds."""
    for time in np.arange(step, drive.duration, step):
        x, y = (np.interp(time, drive.truth[:, 0], drive.truth[:, column]) for column in (1, 2))
        axes.plot(x, y, ".", color="black", markersize=4)
        axes.annotate(f"{time:g} s", (x, y), (4, 4), textcoords="offset points", fontsize=7)


def _draw_over_time(axes: dict[str, Axes], drive: DriveReport, commands: tuple[str, str]) -> None:
    safety = drive.safety_filter
    if safety is not None:
        for name, column in (("speed", 0), ("turn", 1)):
            axes[name].step(safety.times, safety.raw[:, column], where="post", color="0.6", label="raw")
            low, high = axes[name].get_ylim()
            axes[name].fill_between(
                safety.times,
                low,
                high,
                where=safety.changed,
                step="post",
                color="tab:red",
                alpha=0.2,
                linewidth=0,
                label="changed by the filter",
            )
        axes["speed"].legend(fontsize=7, frameon=False)
    axes["clearance"].plot(*drive.clearance.T, color="tab:blue")
    axes["clearance"].axhline(0.0, color="tab:red", linewidth=1)
    axes["clearance"].set_ylabel("clearance\n[m]")
    axes["speed"].step(drive.commands[:, 0], drive.commands[:, 1], where="post", color="tab:green")
    axes["speed"].set_ylabel(commands[0])
    axes["turn"].step(drive.commands[:, 0], drive.commands[:, 2], where="post", color="tab:orange")
    axes["turn"].set_ylabel(commands[1])
    if "reach" in axes:
        axes["reach"].set_ylabel("time to\nreach [s]")
        best = drive.time_to_reach
        axes["reach"].plot(drive.rewards[:, 0], drive.rewards[:, 2], color="tab:purple", label="on the way")
        axes["reach"].plot((0.0, best), (best, 0.0), "--", color="0.5", linewidth=1, label="at best")
        axes["reach"].legend(fontsize=7, frameon=False)
    if "value" in axes:
        axes["value"].plot(*drive.oc_values.T, color="tab:brown")
        axes["value"].set_ylabel("optimal\nvalue")
    if "error" in axes:
        axes["error"].plot(*drive.predictions[:, :2].T, color="tab:cyan", label="model")
        axes["error"].plot(*drive.predictions[:, [0, 2]].T, color="0.5", linewidth=1, label="nothing changes")
        axes["error"].set_ylabel("one-step\nerror")
        axes["error"].legend(fontsize=7, frameon=False)

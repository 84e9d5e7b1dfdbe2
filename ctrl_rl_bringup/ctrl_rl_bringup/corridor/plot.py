"""The pictures of a drive: its path over the task's walls, and what happened over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from ctrl_rl_core.plots import (
    Series,
    draw_mover,
    draw_path,
    draw_robot,
    draw_series,
    draw_world,
    map_beside,
    mark_clearance,
    name_axes,
    picture,
    word_at,
)
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ctrl_rl_bringup.corridor.report import DriveReport
from ctrl_rl_bringup.runner.monitor import OUTCOMES
from ctrl_rl_core import NavigationTask, load_navigation_task

_COMMANDS = {"xy": ("speed [m/s]", "turn rate [rad/s]"), "xz": ("$T_1$ [N]", "$T_2$ [N]")}
"""Names of the two commands by the plane of the task."""


def draw_drive(drive: DriveReport, path: Path) -> None:
    """Write the path with clearance and commands, and beside it, as values.svg, the values that were recorded."""
    task = load_navigation_task(drive.task)
    title = f"{task.name}: {OUTCOMES[drive.outcome]} after {drive.duration:.1f} s, never nearer than "
    title += f"{drive.smallest_clearance:.2f} m to a wall or an obstacle"
    with picture(path, title, 3, 2, height=4.4, width_ratios=(1.4, 1)) as (_, axes):
        ground = map_beside(axes)
        _draw_map(ground, task, drive)
        safety = drive.safety_filter
        acted = None if safety is None else (safety.times, safety.changed)
        series = [Series("clearance [m]", drive.clearance[:, 0], drive.clearance[:, 1], limit=0.0)]
        for column, name in enumerate(_COMMANDS[task.plane], 1):
            raw = None if safety is None else (safety.times, safety.raw[:, column - 1])
            series.append(Series(name, drive.commands[:, 0], drive.commands[:, column], raw, steps=True))
        draw_series(axes[:, 1], series, drive.duration, acted)
    values = _values(drive)
    if values:
        file = path.with_name("values.svg")
        with picture(file, f"{task.name}: values on the way", len(values), height=1.0 + 1.2 * len(values)) as (_, axes):
            draw_series(axes[:, 0], values, drive.duration)


def _values(drive: DriveReport) -> list[Series]:
    """Return what value functions and the latent model said on the way."""
    out = []
    if len(drive.rewards):
        best = np.array([0.0, drive.time_to_reach])
        out.append(
            Series("time to reach [s]; dotted: at best", drive.rewards[:, 0], drive.rewards[:, 2], (best, best[::-1]))
        )
    if len(drive.oc_values):
        out.append(Series("optimal value", drive.oc_values[:, 0], drive.oc_values[:, 1]))
    if len(drive.predictions):
        times, error, still = drive.predictions.T
        out.append(Series("one-step error; dotted: of 'nothing changes'", times, error, (times, still)))
    return out


def _draw_map(axes: Axes, task: NavigationTask, drive: DriveReport) -> None:
    draw_world(axes, task, drive.width)
    times, places = drive.truth[:, 0], drive.truth[:, 1:3]
    if len(places) > 1:
        draw_path(axes, places, times=times)
        radius, flies = task.robot.radius, task.plane == "xz"
        draw_robot(axes, places[0], _heading(places), radius, flies=flies)
        word_at(axes, "start", (float(places[0, 0]), float(places[0, 1])))
    if len(places) > 1 and len(drive.clearance):
        moment, least = drive.clearance[np.argmin(drive.clearance[:, 1])]
        mark_clearance(axes, [np.interp(moment, times, column) for column in places.T], float(least))
    for mover in drive.movers:
        driven = mover.track[mover.track[:, 0] <= drive.duration]
        distances = [
            np.hypot(*(np.array(mover.at(time)) - [np.interp(time, times, column) for column in places.T]))
            for time in driven[:, 0]
        ]
        nearest = driven[int(np.argmin(distances)), 0] if distances else 0.0
        draw_mover(axes, driven[:, 1:], mover.at(float(nearest)), mover.radius)
    name_axes(axes, "x", task.plane[1])
    axes.autoscale_view()


def _heading(places: NDArray[np.float64]) -> float:
    """Return the direction in which a path (n, 2) begins [rad]."""
    far = places[np.linalg.norm(places - places[0], axis=1) > 0.05]
    step = (far[0] if len(far) else places[-1]) - places[0]
    return float(np.arctan2(step[1], step[0]))

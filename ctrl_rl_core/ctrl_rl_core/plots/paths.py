"""Robots to scale, their paths, and people who cross them."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.plots.maps import draw_map
from ctrl_rl_core.plots.roles import DANGER
from ctrl_rl_core.plots.style import picture
from ctrl_rl_core.plots.words import word_at
from ctrl_rl_core.tasks.regions import ANGLES, position_indices
from ctrl_rl_core.tasks.task import NavigationTask

Array = NDArray[np.float64]
_TIME_STEPS, _MOST_MARKS = (10.0, 20.0, 30.0, 60.0, 300.0, 1800.0, np.inf), 10
_STANDING = 0.05
"""Distance within which a robot counts as standing [m]."""
_SNAPSHOTS = 6
_EDGE = [patheffects.withStroke(linewidth=4.0, foreground="white")]


def draw_path(
    axes: Axes,
    places: ArrayLike,
    *,
    planned: bool = False,
    colour: str = "black",
    times: ArrayLike | None = None,
    every: float = 5.0,
) -> None:
    """Draw a driven or planned path.

    Args:
        axes: Axes to draw on.
        places: Positions (n, 2) [m].
        planned: Whether the path is only planned, and so drawn dashed.
        colour: Colour of the line; with several robots, that of its robot.
        times: Time at each position (n,) [s]; None for no time marks.
        every: Minimum time between two marks, of which there are at most ten [s]; a longer stop is marked by a square.
    """
    x, y = np.asarray(places, dtype=float).T
    axes.plot(x, y, "--" if planned else "-", color=colour, linewidth=2.0, path_effects=_EDGE, zorder=5)
    if times is None:
        return
    stamps = np.asarray(times, dtype=float)
    every = next(step for step in (every, *_TIME_STEPS) if (stamps[-1] - stamps[0]) / step <= _MOST_MARKS)
    stops = stretches_of_standing(stamps, np.column_stack((x, y)), every)
    for first, last in stops:
        at = float(x[first]), float(y[first])
        axes.plot(*at, "s", color="white", markeredgecolor=colour, markersize=7, zorder=6)
        word_at(axes, f"{stamps[last] - stamps[first]:.0f} s standing", at)
    for moment in np.arange(every, stamps[-1], every):
        if not any(stamps[first] <= moment <= stamps[last] for first, last in stops):
            at = float(np.interp(moment, stamps, x)), float(np.interp(moment, stamps, y))
            axes.plot(*at, "|", color="white", markeredgecolor=colour, markersize=6, zorder=6)
            word_at(axes, f"{moment:g} s", at)


def stretches_of_standing(times: Array, places: Array, longer: float) -> list[tuple[int, int]]:
    """Return the first and last index of each interval in which a robot stood for longer than a time [s]."""
    out, first = [], 0
    while first < len(times):
        away = np.flatnonzero(np.linalg.norm(places[first:] - places[first], axis=1) > _STANDING)
        last = first + (int(away[0]) - 1 if len(away) else len(times) - first - 1)
        if times[last] - times[first] > longer:
            out.append((first, last))
            first = last
        first += 1
    return out


def draw_robot(
    axes: Axes, place: ArrayLike, heading: float, radius: float, colour: str = "white", flies: bool = False
) -> None:
    """Draw a robot to scale: its disc with its heading, or the bar of a planar quadrotor at its pitch."""
    x, y = np.asarray(place, dtype=float)
    if flies:  # the bar is perpendicular to the thrust, at pitch psi clockwise
        reach = radius * np.array([np.cos(heading), -np.sin(heading)])
        axes.plot([x - reach[0], x + reach[0]], [y - reach[1], y + reach[1]], color="black", linewidth=2.5, zorder=7)
        return
    axes.add_patch(Circle((x, y), radius, facecolor=colour, edgecolor="black", linewidth=1.2, zorder=7))
    nose = radius * np.array([np.cos(heading), np.sin(heading)])
    axes.plot([x, x + nose[0]], [y, y + nose[1]], color="black", linewidth=1.2, zorder=8)


def draw_mover(axes: Axes, track: ArrayLike, at: ArrayLike, radius: float, name: str = "") -> Circle:
    """Draw a person or other mover to scale at its nearest position, with its path (n, 2) [m]; return its disc."""
    axes.plot(*np.asarray(track, dtype=float).T, ":", color=DANGER, linewidth=1.4, zorder=4)
    x, y = np.asarray(at, dtype=float)
    disc = Circle((x, y), radius, color=DANGER, linewidth=0, zorder=6)
    axes.add_patch(disc)
    if name:
        word_at(axes, name, (float(x), float(y)), DANGER)
    return disc


def mark_clearance(axes: Axes, place: ArrayLike, clearance: float) -> None:
    """Mark the position of minimum clearance [m] with a ring and its value."""
    x, y = np.asarray(place, dtype=float)
    axes.plot(x, y, "o", color=DANGER, markerfacecolor="none", markersize=10, zorder=8)
    word_at(axes, f"{clearance:.2f} m", (float(x), float(y)))


def draw_paths(path: Path, title: str, task: NavigationTask, panels: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Draw paths in a task's world, with the robot to scale at a few moments.

    Args:
        path: File to write.
        title: Title; a sentence that states the finding.
        task: Task of the paths.
        panels: Paths by panel name, at most three panels: `states` (n, d), and the `outcome`, if any.
    """
    names = task.system.build().state_names
    plane = position_indices(names)
    angle = next((index for index, name in enumerate(names) if name in ANGLES), None)
    shown = dict(list(panels.items())[:3])
    (_, width), (_, height) = task.plane_bounds.items()
    tall = (2.7 if len(shown) == 1 else 6.0 / len(shown)) * height.length / width.length
    with picture(path, title, 1, len(shown), height=min(tall + 1.5, 6.0), half=len(shown) == 1,
                 sharex=True, sharey=True) as (_, axes):  # fmt: skip
        for ax, (name, entries) in zip(axes[0], shown.items(), strict=True):
            draw_map(ax, task)
            ends = [entry["outcome"] for entry in entries if "outcome" in entry]
            told = f"{name}: {ends.count('GOAL')} of {len(ends)} reach the goal" if ends else name
            ax.set_title(textwrap.fill(told, 28))
            for entry in entries:
                states = np.asarray(entry["states"], dtype=float)
                places = states[:, plane]
                draw_path(ax, places)
                for index in np.linspace(0, len(states) - 1, _SNAPSHOTS).astype(int):
                    turn = 0.0 if angle is None else states[index, angle]
                    draw_robot(ax, places[index], turn, task.robot.radius, flies=task.plane == "xz")
                if entry.get("outcome") == "COLLISION":
                    ax.plot(*places[-1], "o", color=DANGER, markerfacecolor="none", markersize=10, zorder=8)
                    word_at(ax, "collision", (float(places[-1, 0]), float(places[-1, 1])), DANGER)
            if entries:
                first = np.asarray(entries[0]["states"], dtype=float)[0, plane]
                word_at(ax, "start", (float(first[0]), float(first[1])))
            ax.label_outer()

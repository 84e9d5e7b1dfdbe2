"""Pictures of learning, drawn from results: a curve over samples, and learnt paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.tasks.regions import ANGLES
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from ctrl_rl_core import NavigationTask, draw_map, position_indices, save_figure

_SNAPSHOTS = 9
_ARM = 0.4


def over_seeds(count: int) -> str:
    """Return what curves over so many seeds show, for a title."""
    return "one seed" if count == 1 else f"mean and standard deviation of {count} seeds"


def draw_curve(
    ax: Axes,
    samples: Sequence[float],
    values: Sequence[Sequence[float]],
    label: str,
    colour: str,
    width: float = 1.3,
    start: float | None = 0.0,
    band: bool = True,
) -> None:
    """Draw the mean over the seeds.

    Args:
        ax: Axes to draw into.
        samples: Samples at each point (iterations,).
        values: Values of each seed (seeds, iterations).
        label: Name of the line in the legend.
        colour: Colour of line and band.
        width: Width of the line [points].
        start: Value before learning, None for none.
        band: Whether to show the standard deviation as well.
    """
    x, y = np.array(samples) / 1000.0, np.array(values)
    if start is not None:
        x, y = np.concatenate(([0.0], x)), np.column_stack((np.full(len(y), start), y))
    mean, spread = y.mean(axis=0), y.std(axis=0)
    ax.plot(x, mean, color=colour, label=label, linewidth=width)
    if band:
        ax.fill_between(x, mean - spread, mean + spread, color=colour, alpha=0.12, linewidth=0)


def draw_paths(paths: Sequence[Mapping[str, Any]], task: NavigationTask, title: str, path: Path) -> None:
    """Draw learnt paths, with the body's angle at a few moments, as Fig. 3.5 does."""
    names = task.system.build().state_names
    plane = position_indices(names)
    angle = next(index for index, name in enumerate(names) if name in ANGLES)
    flies = names[plane[1]] == "z"
    figure, ax = plt.subplots(figsize=(5.0, 5.0), layout="constrained")
    draw_map(ax, task)
    for number, entry in enumerate(paths, 1):
        states = np.array(entry["states"])
        x, y = states[:, plane[0]], states[:, plane[1]]
        (line,) = ax.plot(x, y, linewidth=1.2, label=f"episode {number}: {entry['outcome'].lower()}")
        for index in np.linspace(0, len(states) - 1, _SNAPSHOTS).astype(int):
            turn = states[index, angle]
            # A quadrotor's bar lies across its thrust, at pitch psi clockwise; a car points along theta.
            reach = _ARM * np.array([np.cos(turn), -np.sin(turn)] if flies else [np.cos(turn), np.sin(turn)])
            ends = np.array([-reach, reach]) if flies else np.array([0.0 * reach, reach])
            ax.plot(x[index] + ends[:, 0], y[index] + ends[:, 1], color=line.get_color(), linewidth=2.5)
    ax.set_title(title, fontsize=10)
    ax.legend(fontsize=8)
    save_figure(figure, path)

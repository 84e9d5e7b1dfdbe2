"""A picture of where recorded drives contradict a task's file: its walls, the beams that contradict, the drives."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_learning.offline.witness.account import Account, contradicting
from ctrl_rl_learning.offline.witness.places import Place

Array = NDArray[np.float64]
_MOST_POINTS, _MOST_PATHS = 4000, 100
_NAMED, _SAME_WALL = 5, 1.0
"""Number of places with a word, and distance that they are apart [m]."""


def draw_account(account: Account, path: Path) -> None:
    """Draw where drives contradict a task's file.

    Raises:
        OSError: The file cannot be written.
    """
    from ctrl_rl_core.plots import FAINT, ROBOTS, SKY, draw_map, legend_below, picture, word_at

    title = _title(account)
    (_, across), (_, up) = account.task.plane_bounds.items()
    height = min(max(7.0 * up.length / max(across.length, 1e-6) + 1.2, 3.0), 7.5)
    with picture(path, title, height=height) as (figure, axes):
        ax = axes[0, 0]
        draw_map(ax, account.task)
        for number, places in enumerate(_thinned(list(account.paths), _MOST_PATHS)):
            label = "drives" if number == 0 else None
            ax.plot(*places.T, "-", color=FAINT, linewidth=0.7, zorder=2, label=label)
        if account.beams is not None:
            shorter, missing = (_few(points) for points in contradicting(account.beams))
            ax.plot(*shorter.T, ".", color=SKY, markersize=2.5, zorder=6, label="beams end here")
            ax.plot(*missing.T, ".", color=ROBOTS[2], markersize=2.5, zorder=5, label="beams pass the file's wall")
            for points in (shorter, missing):
                _widen(ax, points)
        for place in _apart(account.moved_walls)[:_NAMED]:
            word_at(ax, f"{place.off:.2f} m off" if place.kind == "unknown" else "not there", place.centre)
        legend_below(figure)


def _apart(places: list[Place]) -> list[Place]:
    """Return places without those beside one that more beams show: two sides of a wall that moved, most often."""
    kept: list[Place] = []
    for place in places:
        if all(math.dist(place.centre, other.centre) > _SAME_WALL for other in kept):
            kept.append(place)
    return kept


def _title(account: Account) -> str:
    walls = len(account.moved_walls)
    if account.offset is not None:
        return f"The recorded poses lie {account.offset.size:.2f} m off the frame of task {account.task.name}"
    if walls:
        return (
            f"{account.differing:.0%} of the beams differ from the walls of task {account.task.name}, at {walls} places"
        )
    return f"What the drives say against the file of task {account.task.name}"


def _few(points: Array) -> Array:
    return points[:: max(1, len(points) // _MOST_POINTS)]


def _thinned(paths: list[Array], most: int) -> list[Array]:
    return paths[:: max(1, len(paths) // most)]


def _widen(ax: object, points: Array) -> None:
    """Let a map's axes hold nearly all points (n, 2)."""
    from matplotlib.axes import Axes

    assert isinstance(ax, Axes)
    if len(points):
        low, high = np.quantile(points, (0.01, 0.99), axis=0)
        (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
        ax.set_xlim(min(left, low[0]), max(right, high[0]))
        ax.set_ylim(min(bottom, low[1]), max(top, high[1]))

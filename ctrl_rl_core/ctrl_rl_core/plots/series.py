"""Time series of a run: at most three quantities over a common time axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.plots.roles import DANGER, FAINT, NO_HELP, OURS_COLOUR
from ctrl_rl_core.plots.words import name_at_end


@dataclass(frozen=True)
class Series:
    """A quantity over the time of a run.

    Attributes:
        title: Quantity and unit.
        times: Times (n,) [s].
        values: Quantity at each time (n,).
        raw: Unfiltered quantity with its times: (times, values).
        limit: Limit for the quantity.
        steps: Whether a value holds until the next, like a command.
    """

    title: str
    times: ArrayLike
    values: ArrayLike
    raw: tuple[ArrayLike, ArrayLike] | None = None
    limit: float | None = None
    steps: bool = False


def draw_series(
    axes: Sequence[Axes] | NDArray[Any],
    series: Sequence[Series],
    duration: float,
    acted: tuple[ArrayLike, ArrayLike] | None = None,
) -> None:
    """Draw stacked quantities over a common time axis.

    Args:
        axes: Panels from top to bottom, one per quantity.
        series: At most three quantities.
        duration: Duration of the run [s].
        acted: Activity of the filter: times (n,) [s], and whether it was active from each time on.
    """
    for ax, one in zip(axes, series, strict=True):
        look = "steps-post" if one.steps else "default"
        if one.raw is not None:
            ax.plot(*one.raw, color=FAINT, linestyle=NO_HELP.line, drawstyle=look)
        ax.plot(one.times, one.values, color=OURS_COLOUR, drawstyle=look)
        if acted is not None:
            for begin, end in _stretches(*acted, duration):
                ax.axvspan(begin, end, color=DANGER, alpha=0.3, linewidth=0)
        if one.limit is not None:
            ax.axhline(one.limit, color=DANGER, linewidth=0.8)
            name_at_end(ax, f"{one.limit:g}", one.limit, DANGER)
        ax.set_title(one.title)
        ax.set_xlim(0.0, max(duration, 1e-3))
        ax.tick_params(labelbottom=False)
    axes[-1].tick_params(labelbottom=True)
    axes[-1].set_xlabel("time [s]")


def _stretches(times: ArrayLike, acted: ArrayLike, duration: float) -> list[tuple[float, float]]:
    """Return the begin and end [s] of each interval in which the filter was active."""
    stamps, on = np.asarray(times, dtype=float), np.asarray(acted, dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(int)))
    ends = np.append(stamps, duration)
    return [(float(ends[begin]), float(ends[end])) for begin, end in edges.reshape(-1, 2)]

"""Plot of a decomposition's error: its distribution, and its map over the plane."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from ctrl_rl_core.plots import BLACK, FAINT, OURS_COLOUR, draw_values, draw_world, legend_below, name_axes, picture
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, position_indices
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.verification.decomposition_error import DecompositionErrors

_BINS, _MOST = 60, 2


def draw_decomposition_errors(gaps: Sequence[DecompositionErrors], task: NavigationTask, path: Path) -> None:
    """Plot the distribution of each error, and each error over the plane at the midpoints of the other components.

    Args:
        gaps: Errors of one or more decompositions of one problem.
        task: Task with the goal and obstacles to draw.
        path: Figure file; replaced if it exists.

    Raises:
        TimeToReachError: There is no plane of positions, or no nodes to compare.
    """
    names = gaps[0].problem.system.state_names
    plane = position_indices(names)
    differences = [gap.differences for gap in gaps]
    if len(plane) < 2 or not all(d.size for d in differences):
        raise TimeToReachError("there is nothing to draw: no plane of positions, or no node that both solutions reach")
    top = max(float(np.quantile(d, 0.99)) for d in differences)
    low = min(0.0, *(float(np.quantile(d, 0.001)) for d in differences))
    shown = list(zip(gaps, differences, strict=True))[:_MOST]
    worst = max(float(np.mean(d)) for d in differences)
    title = f"{task.name}: decomposition misses up to {worst:.2f} s of the time on average"
    with picture(path, title, 1, 1 + len(shown), height=3.0) as (figure, ((beside, *maps),)):
        for (gap, d), colour in zip(shown, (OURS_COLOUR, BLACK), strict=False):
            beside.hist(d, bins=_BINS, range=(low, top), density=True, histtype="step", color=colour, label=_label(gap))
        beside.axvline(0.0, color=FAINT, linewidth=0.8)
        beside.set_xlabel("whole less decomposed [s]")
        beside.set_ylabel("density [1/s]")
        image = None
        for (gap, _), ax in zip(shown, maps, strict=True):
            first, second = (gap.problem.axes[k] for k in plane)
            layer, where = _slice(gap, plane)
            image = draw_values(ax, first.nodes, second.nodes, layer.T, "time", (0.0, top))
            draw_world(ax, task)
            ax.set_xlim(first.lower, first.upper)
            ax.set_ylim(second.lower, second.upper)
            name_axes(ax, first.name, second.name)
            ax.set_title(f"{gap.decomposition}\n{textwrap.fill(where, 26)}")
        assert image is not None
        figure.colorbar(image, ax=maps, label="whole less decomposed [s]")
        legend_below(figure, len(shown))


def _slice(gap: DecompositionErrors, plane: Sequence[int]) -> tuple[NDArray[np.float32], str]:
    """Return the error over the plane (first, second), NaN where undefined, and a description of the slice."""
    index: list[slice | int] = []
    at = []
    for k, axis in enumerate(gap.problem.axes):
        if k in plane:
            index.append(slice(None))
            continue
        middle = int(np.argmin(np.abs(axis.nodes - 0.5 * (axis.lower + axis.upper))))
        index.append(middle)
        at.append(f"{axis.name} = {axis.nodes[middle]:.2g}")
    whole, bound = gap.whole[tuple(index)], gap.bound[tuple(index)]
    there = np.isfinite(whole) & np.isfinite(bound)
    out = np.full(whole.shape, np.nan, dtype=np.float32)
    out[there] = whole[there] - bound[there]
    return out, ", ".join(at)


def _label(gap: DecompositionErrors) -> str:
    d = gap.differences
    return f"{gap.decomposition}: mean {d.mean():.2f} s, p95 {np.quantile(d, 0.95):.2f} s"

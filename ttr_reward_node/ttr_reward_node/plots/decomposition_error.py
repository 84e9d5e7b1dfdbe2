"""Plot of a decomposition's error: its distribution, and its place in the plane."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, draw_world, position_indices, save_figure
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.verification.decomposition_error import DecompositionErrors

_BINS = 60


def draw_decomposition_errors(gaps: Sequence[DecompositionErrors], task: NavigationTask, path: Path) -> None:
    """Draw the distribution of each error, and each error over the plane at the other components' middle.

    Args:
        gaps: Errors of one or more decompositions of one problem.
        task: Task with the goal and obstacles to draw.
        path: File of the picture; replaced if it exists.

    Raises:
        TimeToReachError: there is no plane of positions, or there are no nodes to compare.
    """
    names = gaps[0].problem.system.state_names
    plane = position_indices(names)
    differences = [gap.differences for gap in gaps]
    if len(plane) < 2 or not all(d.size for d in differences):
        raise TimeToReachError("there is nothing to draw: no plane of positions, or no node that both solutions reach")
    top = max(float(np.quantile(d, 0.99)) for d in differences)
    low = min(0.0, *(float(np.quantile(d, 0.001)) for d in differences))
    figure, axes = plt.subplots(1, 1 + len(gaps), figsize=(4.4 * (1 + len(gaps)), 4.0), layout="constrained")
    for gap, d in zip(gaps, differences, strict=True):
        axes[0].hist(d, bins=_BINS, range=(low, top), density=True, histtype="step", label=_label(gap))
    axes[0].axvline(0.0, color="0.5", linewidth=0.8)
    axes[0].set_xlabel("whole minus decomposed [s]")
    axes[0].set_ylabel("density [1/s]")
    axes[0].legend(fontsize=8)
    image = None
    for gap, ax in zip(gaps, axes[1:], strict=True):
        first, second = (gap.problem.axes[k] for k in plane)
        layer, where = _slice(gap, plane)
        image = ax.pcolormesh(first.nodes, second.nodes, layer.T, vmin=0.0, vmax=top, cmap="magma_r", shading="nearest")
        draw_world(ax, task)
        ax.set_facecolor("0.85")
        ax.set_xlim(first.lower, first.upper)
        ax.set_ylim(second.lower, second.upper)
        ax.set_xlabel(f"{first.name} [{first.unit}]")
        ax.set_ylabel(f"{second.name} [{second.unit}]")
        ax.set_title(f"{gap.decomposition} at {where}", fontsize=8)
    assert image is not None
    figure.colorbar(image, ax=list(axes[1:]), label="whole minus decomposed [s]", shrink=0.85)
    figure.suptitle(
        f"{task.name}: cost of decomposition, {' x '.join(map(str, gaps[0].problem.counts))} nodes; grey: unreachable",
        fontsize=10,
    )
    save_figure(figure, path)


def _slice(gap: DecompositionErrors, plane: Sequence[int]) -> tuple[NDArray[np.float32], str]:
    """Return the error over the plane (first, second), NaN where it is not defined, and the place of the slice."""
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

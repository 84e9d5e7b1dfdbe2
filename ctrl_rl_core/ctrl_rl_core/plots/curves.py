"""Learning curves over environment steps, and final results per seed."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import ScalarFormatter, SymmetricalLogLocator
from numpy.typing import NDArray

from ctrl_rl_core.plots.roles import BLACK, FAINT, Style, style_of
from ctrl_rl_core.plots.style import legend_below, picture
from ctrl_rl_core.plots.words import name_at_end, word_at

Array = NDArray[np.float64]
STEPS = "environment steps [thousands]"
SUCCESS, RETURN = "success [%]", "return"
MOST_LINES, MOST_PANELS = 5, 6
_BAND_FROM = 10
"""Minimum number of seeds for a confidence band; fewer seeds are drawn as lines."""
_POINTS_TO = 2
"""Maximum number of seeds drawn as points; too few for a mean line."""
_COLUMNS = 3
_PANELS = 4
"""Largest number of panels side by side in which a title of two short lines fits."""
_RESAMPLES = 1000
_NAME_LENGTH = 26
_MARKERS = "osD^v"


@dataclass(frozen=True)
class Line:
    """Evaluations of a method during training.

    Attributes:
        method: Name of the method, which selects the line style.
        label: Label in the figure.
        steps: Environment steps (n,).
        values: Result of each seed at each step (seeds, n).
    """

    method: str
    label: str
    steps: Sequence[float]
    values: Sequence[Sequence[float]] | Array

    @property
    def name(self) -> str:
        """Label with the number of seeds."""
        return f"{self.label} (n\u00a0=\u00a0{len(self.values)})"  # not broken across lines

    @property
    def end(self) -> float:
        """Mean over the seeds at the last step."""
        return float(np.mean(np.asarray(self.values, dtype=float)[:, -1]))


def line_of(method: str, label: str, curve: Mapping[str, Any], key: str = "values") -> Line:
    """Create a line from a curve of a results file: success rate in per cent, starting at 0 before training.

    Args:
        method: Name of the method.
        label: Label in the figure.
        curve: `samples` (n,), and values of the seeds (seeds, n) under `key`.
        key: Name of the values, such as "success".
    """
    steps, values = curve["samples"], np.asarray(curve[key], dtype=float)
    if key != "success":
        return Line(method, label, steps, values)
    return Line(method, label, (0.0, *steps), np.column_stack((np.zeros(len(values)), 100.0 * values)))


@dataclass(frozen=True)
class Panel:
    """One panel of curves.

    Attributes:
        title: Name of the task or learner; empty for a single panel.
        lines: At most `MOST_LINES` lines.
        limits: Values of thin horizontal lines by name, such as the maximum return.
        published: Published results by name: mean after numbers of environment steps.
        missing: Methods that were not run, named in the panel.
    """

    title: str
    lines: Sequence[Line]
    limits: Mapping[str, float] = field(default_factory=dict)
    published: Mapping[str, Mapping[int, float]] = field(default_factory=dict)
    missing: Sequence[str] = ()


def draw_learning(
    path: Path, title: str, panels: Sequence[Panel], measure: str = SUCCESS, orders_of_magnitude: float | None = None
) -> None:
    """Draw learning curves: seeds as thin lines, with a bootstrapped 95 % band from 10 seeds on.

    Args:
        path: File to write.
        title: Title; a sentence that states the finding.
        panels: At most `MOST_PANELS` panels.
        measure: Measured quantity with its unit; `SUCCESS` ranges from 0 to 100.
        orders_of_magnitude: Minimum magnitude on a logarithmic axis, for all-negative values that span orders of
            magnitude; None for a linear axis.
    """
    panels = panels[:MOST_PANELS]
    columns = 2 if len(panels) == 4 else min(len(panels), _COLUMNS)
    rows = -(-len(panels) // columns)
    alone = len(panels) == 1
    height = 2.9 if alone else 0.6 + 2.0 * rows + 0.25
    with picture(path, title, rows, columns, height=height, sharex=True, sharey=True) as (figure, axes):
        for ax in axes.flat[len(panels) :]:
            ax.set_axis_off()
        taken: dict[str, Style] = {}
        counts = {len(line.values) for panel in panels for line in panel.lines}
        for ax, panel in zip(axes.flat, panels, strict=False):
            _draw_panel(ax, panel, measure, taken, alone, len(counts) == 1)
            if orders_of_magnitude is not None:
                ax.set_yscale("symlog", linthresh=orders_of_magnitude)
                ax.set_ylim(top=-orders_of_magnitude)
                ax.yaxis.set_major_locator(SymmetricalLogLocator(base=10.0, linthresh=1.0, subs=(1.0, 2.0, 5.0)))
                ax.yaxis.set_major_formatter(ScalarFormatter())
        for ax in axes[:, 0]:
            ax.set_ylabel(measure)
        axes[-1, columns // 2 if columns != 2 else 0].set_xlabel(STEPS)
        if not alone:
            legend_below(figure)


def _draw_panel(ax: Axes, panel: Panel, measure: str, taken: dict[str, Style], alone: bool, same_count: bool) -> None:
    last = max((line.steps[-1] for line in panel.lines), default=0.0)
    names: list[tuple[str, float, str]] = []
    for line in panel.lines[:MOST_LINES]:
        taken.setdefault(line.method, style_of(line.method, taken))
        name = line.name if alone or same_count else line.label
        _draw_line(ax, line, taken[line.method], "" if alone else name, last)
        names.append((line.name, line.end, taken[line.method].colour))
    for name, height in panel.limits.items():
        ax.axhline(height, color=FAINT, linewidth=0.8)
        names.append((name, height, FAINT))
    for (name, points), marker in zip(panel.published.items(), _MARKERS, strict=False):
        steps, heights = [each / 1000.0 for each in points], list(points.values())
        ax.plot(steps, heights, marker, color=BLACK, markersize=4, linestyle=":", linewidth=0.8)
        if alone:
            names.append((name, heights[-1], BLACK))
        else:
            word_at(ax, name, (steps[0], heights[0]))
    if panel.missing:
        ax.text(0.03, 0.5, "not run: " + ", ".join(panel.missing), transform=ax.transAxes, wrap=True)
    if alone:
        for name, height, colour in names:
            name_at_end(ax, textwrap.fill(name, _NAME_LENGTH), height, colour)
    ax.set_title(panel.title)
    if measure == SUCCESS:
        ax.set_ylim(-4.0, 104.0)
        ax.set_yticks([0, 25, 50, 75, 100])


def _draw_line(ax: Axes, line: Line, style: Style, label: str, last: float) -> None:
    x, y = np.asarray(line.steps, dtype=float) / 1000.0, np.asarray(line.values, dtype=float)
    if len(y) <= _POINTS_TO:
        for seed in y:
            ax.plot(x, seed, style.marker, color=style.colour, markersize=3.5, linestyle="None", label=label or None)
            label = ""
    else:
        look: Mapping[str, Any] = {"color": style.colour, "linestyle": style.line}
        if len(y) < _BAND_FROM:
            ax.plot(x, y.T, color=style.colour, linewidth=0.7, alpha=0.35)
        else:
            low, high = confidence(y)
            ax.fill_between(x, low, high, color=style.colour, alpha=0.2, linewidth=0)
        ax.plot(x, y.mean(axis=0), **look, linewidth=style.width, label=label or None)
    if line.steps[-1] < 0.98 * last:
        for end in y[:, -1] if len(y) <= _POINTS_TO else [y[:, -1].mean()]:
            ax.plot(x[-1], end, "o", color=style.colour, markerfacecolor="white", markersize=6)


def confidence(values: Array) -> tuple[Array, Array]:
    """Return the bootstrapped 95 % confidence band (n,) of the mean over seeds, from values (seeds, n)."""
    random = np.random.default_rng(0)
    chosen = random.integers(len(values), size=(_RESAMPLES, len(values)))
    low, high = np.quantile(values[chosen].mean(axis=1), (0.025, 0.975), axis=0)
    return low, high


def draw_ends(
    path: Path,
    title: str,
    ends: Mapping[str, Mapping[str, Sequence[float]]],
    labels: Mapping[str, str],
    measure: str = SUCCESS,
    decimals: int = 0,
) -> None:
    """Draw final results: a dot per seed and a bar for their mean, the best first.

    Args:
        path: File to write.
        title: Title; a sentence that states the finding.
        ends: Values of the seeds, by method and then by learner.
        labels: Short labels of the methods, at most four, each with its own panel.
        measure: Measured quantity with its unit.
        decimals: Decimals of the means.

    Raises:
        ValueError: There are more methods than panels.
    """
    methods = [method for method in ends if method in labels]
    if len(methods) > _PANELS:
        raise ValueError(f"{len(methods)} methods to draw: at most {_PANELS}")
    gap = "\n" if len(methods) > _COLUMNS else " "
    learnt = list(dict.fromkeys(name for method in methods for name in ends[method]))
    learnt.sort(key=lambda name: -sum(float(np.mean(ends[method].get(name, 0.0))) for method in methods))
    taken: dict[str, Style] = {}
    with picture(
        path, title, 1, len(methods), height=0.9 + 0.24 * len(learnt), sharex=True, sharey=True
    ) as (_, axes):  # fmt: skip
        for ax, method in zip(axes[0], methods, strict=True):
            taken[method] = style_of(method, taken)
            counts = {len(values) for values in ends[method].values()}
            ax.set_title(f"{labels[method]}{gap}(n = {'–'.join(map(str, sorted(counts)))})")
            ax.grid(visible=False)
            for row, name in enumerate(learnt):
                values = np.asarray(ends[method].get(name, ()), dtype=float)
                if not len(values):
                    ax.text(0.5, row, "not run", horizontalalignment="center", verticalalignment="center",
                            transform=ax.get_yaxis_transform(), color=FAINT)  # fmt: skip
                    continue
                ax.barh(row, values.mean(), height=0.7, color=taken[method].colour, alpha=0.25)
                ax.plot(values, row + np.linspace(-0.2, 0.2, len(values)), "o", color=taken[method].colour,
                        markersize=3, linestyle="None")  # fmt: skip
                ax.annotate(f"{values.mean():.{decimals}f}", (1.0, row), (4.0, 0.0), annotation_clip=False,
                            xycoords=ax.get_yaxis_transform(), textcoords="offset points",
                            verticalalignment="center")  # fmt: skip
            ax.set_xlabel(measure)
            if measure == SUCCESS:
                ax.set_xlim(0.0, 104.0)
                ax.set_xticks([0, 50, 100])
        axes[0, 0].set_yticks(range(len(learnt)), learnt)
        axes[0, 0].set_ylim(len(learnt) - 0.5, -0.5)


def best_of(lines: Iterable[Line], measure: str = SUCCESS) -> str:
    """Describe the final values of the first line and of the best other line."""
    first, *others = lines
    unit = " %" if measure == SUCCESS else ""
    told = f"{first.label} ends at {first.end:.0f}{unit}"
    if not others:
        return told
    best = max(others, key=lambda line: line.end)
    return f"{told}, {best.label} at {best.end:.0f}{unit}"

"""Pictures of returns while learning: of comparisons (thesis Fig. 4.8, 4.9; 4.3 from a reference), of last policies."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from ctrl_rl_core.io.file_checks import short_repr
from ctrl_rl_core.io.schema import Name
from ctrl_rl_training.experiments.figure_data import Figures, Seeds, ValueCurve
from ctrl_rl_training.experiments.results import read_figures
from ctrl_rl_training.plots import draw_curve, over_seeds
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from pydantic import Field, model_validator

from ctrl_rl_core import save_figure
from koopman_lqr_controller.training.experiments.last_curves import PUBLISHED, LastPolicies
from koopman_lqr_controller.training.experiments.methods import METHODS

_MARKERS = "osD^v"
_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown")


class Comparison(Figures):
    """What a comparison is drawn from, see `collect_comparison`."""

    comparison: Name
    kind: Literal["curves", "gaps", "levels", "finals"]
    reference: float | None
    curves: Annotated[dict[str, ValueCurve], Field(min_length=1, max_length=100)]

    @model_validator(mode="after")
    def _known(self) -> Comparison:
        unknown = [method for method in self.curves if method not in METHODS]
        if unknown:
            raise ValueError(f"curves: no method {short_repr(unknown[0])}: there are {', '.join(METHODS)}")
        if self.kind == "gaps" and self.reference is None:
            raise ValueError("reference: a gap needs one")
        return self


class Training(Figures):
    """What a run of `train` is drawn from, see `collect`: by candidate, a curve of each seed, beside their `steps`."""

    curves: Annotated[dict[Name, Seeds], Field(min_length=2, max_length=100)]

    @model_validator(mode="after")
    def _against_steps(self) -> Training:
        steps = self.curves.get("steps")
        if steps is None:
            raise ValueError("curves: there are no steps")
        for name, seeds in self.curves.items():
            if [len(seed) for seed in seeds] != [len(seed) for seed in steps]:
                raise ValueError(f"curves.{name}: not one value for each of the steps")
        return self


def draw(file: Path, path: Path) -> None:
    """Draw a results file of `train` or `compare`.

    Args:
        file: Results file that `train` or `compare` wrote.
        path: Path of the picture.

    Raises:
        ResultsError: There is no such file, or it holds something else.
    """
    figures = read_figures(file, Figures)
    if "last_policies" in figures:
        draw_last_policies(read_figures(file, LastPolicies), path)
    elif "comparison" in figures:
        draw_comparison(read_figures(file, Comparison), path)
    else:
        draw_training(read_figures(file, Training), path)


def draw_training(figures: Mapping[str, Any], path: Path) -> None:
    """Draw the evaluations of each seed, a colour for each candidate.

    Args:
        figures: Figures' data of `collect`.
        path: Path of the picture.
    """
    figure, ax = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    steps = figures["curves"]["steps"]
    candidates = [name for name in figures["curves"] if name != "steps"]
    for name, colour in zip(candidates, _COLOURS, strict=False):
        for number, (at, values) in enumerate(zip(steps, figures["curves"][name], strict=True)):
            label = name if number == 0 else None
            ax.plot(np.array(at) / 1000.0, values, color=colour, linewidth=1.0, alpha=0.8, label=label)
    _finish(ax, "steps of the system [thousands]", "return")
    ax.set_title(f"{figures['task']}: a line for each of {len(steps)} seeds", fontsize=10)
    save_figure(figure, path)


def draw_comparison(figures: Mapping[str, Any], path: Path) -> None:
    """Draw mean and standard deviation over the seeds.

    Args:
        figures: Figures' data of `collect_comparison`.
        path: Path of the picture.
    """
    gaps = figures["kind"] == "gaps"
    figure, ax = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    for number, (method, curve) in enumerate(figures["curves"].items()):
        values = np.array(curve["values"])
        shown = figures["reference"] - values if gaps else values
        colour = _COLOURS[number % len(_COLOURS)]
        draw_curve(ax, curve["samples"], shown.tolist(), METHODS[method].label, colour, start=None)
    if gaps:
        ax.axhline(0.0, color="k", linewidth=0.8, linestyle=":")
    _finish(ax, "steps of the system [thousands]", "reference return less ours" if gaps else "return")
    seeds = max(len(curve["values"]) for curve in figures["curves"].values())
    ax.set_title(f"{figures['task']}: {over_seeds(seeds)}", fontsize=10)
    save_figure(figure, path)


def draw_last_policies(figures: Mapping[str, Any], path: Path) -> None:
    """Draw returns over simulated frames, a panel for each task, beside what others publish.

    Args:
        figures: Figures' data of `collect_curves`.
        path: Path of the picture.
    """
    panels: dict[str, list[str]] = {}
    for method in figures["last_policies"]:
        panels.setdefault(method.removesuffix("_fine"), []).append(method)
    figure, axes = plt.subplots(1, len(panels), figsize=(7.0 * len(panels), 4.2), layout="constrained", squeeze=False)
    for ax, (task, methods) in zip(axes[0], panels.items(), strict=True):
        for method, colour in zip(methods, _COLOURS, strict=False):
            curve = figures["last_policies"][method]["curve"]
            label = f"{method}, {over_seeds(len(curve['values']))}"
            draw_curve(ax, curve["samples"], curve["values"], label, colour, start=None)
        for (name, points), marker in zip(PUBLISHED.get(task, {}).items(), _MARKERS, strict=False):
            frames = [each / 1000.0 for each in points]
            ax.plot(frames, list(points.values()), marker, color="0.3", markersize=5, label=f"{name}, published")
        _finish(ax, "simulated frames [thousands]", "return")
        ax.set_title(task, fontsize=10)
    save_figure(figure, path)


def _finish(ax: Axes, x: str, y: str) -> None:
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)

"""Figures of returns during training: comparisons (thesis Fig. 4.8, 4.9; 4.3 from a reference), and last policies."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from ctrl_rl_core.io import Name, short_repr
from ctrl_rl_core.plots import MOST_LINES, RETURN, Line, Panel, best_of, draw_learning, line_of
from ctrl_rl_learning.study import Figures, Seeds, ValueCurve, read_figures
from pydantic import Field, model_validator

from koopman_lqr_controller.training.experiments.last_curves import LastPolicies
from koopman_lqr_controller.training.experiments.methods import METHODS
from koopman_lqr_controller.training.experiments.references import published_means


class Comparison(Figures):
    """Data of a comparison figure, see `collect_comparison`."""

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
    """Data of a `train` figure, see `collect`: a curve per seed and candidate, with its `steps`."""

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
        file: Results file written by `train` or `compare`.
        path: Path of the figure.

    Raises:
        ResultsError: The file does not exist or has other content.
    """
    figures = read_figures(file, Figures)
    if "last_policies" in figures:
        draw_last_policies(read_figures(file, LastPolicies), path)
    elif "comparison" in figures:
        draw_comparison(read_figures(file, Comparison), path)
    else:
        draw_training(read_figures(file, Training), path)


def draw_training(figures: Mapping[str, Any], path: Path) -> None:
    """Draw the evaluations of each seed for each candidate.

    Args:
        figures: Figure data from `collect`.
        path: Path of the figure.
    """
    curves = dict(figures["curves"])
    steps = min(curves.pop("steps"), key=len)
    lines = [
        Line(name, name, steps, [seed[: len(steps)] for seed in seeds]) for name, seeds in curves.items()
    ][:MOST_LINES]  # fmt: skip
    draw_learning(path, f"{figures['task']}: {best_of(lines, RETURN)}", [Panel("", lines)], RETURN)


def draw_comparison(figures: Mapping[str, Any], path: Path) -> None:
    """Draw returns, or their gap to a reference, during training.

    Args:
        figures: Figure data from `collect_comparison`.
        path: Path of the figure.
    """
    gaps, reference = figures["kind"] == "gaps", figures["reference"]
    measure = "reference return less ours" if gaps else RETURN
    lines = []
    for method, curve in list(figures["curves"].items())[:MOST_LINES]:
        values = np.asarray(curve["values"])
        lines.append(Line(method, METHODS[method].label, curve["samples"], reference - values if gaps else values))
    limits = {"the reference": 0.0 if gaps else reference} if reference is not None else {}
    title = f"{figures['task']}: {best_of(lines, measure)}"
    if gaps:
        side = "below" if lines[0].end > 0.0 else "above"
        title = f"{figures['task']}: {abs(lines[0].end):.0f} {side} the reference of {reference:.0f} at the end"
    draw_learning(path, title, [Panel("", lines, limits)], measure)


def draw_last_policies(figures: Mapping[str, Any], path: Path) -> None:
    """Draw returns over environment steps, a panel per task, with published results.

    Args:
        figures: Figure data from `collect_curves`.
        path: Path of the figure.
    """
    panels: dict[str, list[Line]] = {}
    for method, each in figures["last_policies"].items():
        task = method.removesuffix("_fine")
        panels.setdefault(task, []).append(line_of(method, "the last policy", each["curve"]))
    title = "; ".join(f"{task}: {best_of(lines, RETURN)}" for task, lines in panels.items())
    shown = [
        Panel(
            task if len(panels) > 1 else "",
            lines,
            published=published_means(task, max(line.steps[-1] for line in lines)),
        )
        for task, lines in panels.items()
    ]
    draw_learning(path, title, shown, RETURN)

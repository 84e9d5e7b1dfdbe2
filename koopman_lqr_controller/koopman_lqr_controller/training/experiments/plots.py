"""Pictures of returns while learning: of comparisons (thesis Fig. 4.8, 4.9; 4.3 from a reference), of last policies."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from ctrl_rl_core.io import Name, short_repr
from ctrl_rl_core.plots import MOST_LINES, RETURN, Line, Panel, best_of, draw_learning, line_of
from ctrl_rl_learning.study import Figures, Seeds, ValueCurve, read_figures
from pydantic import Field, model_validator

from koopman_lqr_controller.training.experiments.last_curves import PUBLISHED, LastPolicies
from koopman_lqr_controller.training.experiments.methods import METHODS


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
    """Draw the evaluations of each seed for each candidate.

    Args:
        figures: Figures' data of `collect`.
        path: Path of the picture.
    """
    curves = dict(figures["curves"])
    steps = min(curves.pop("steps"), key=len)
    lines = [
        Line(name, name, steps, [seed[: len(steps)] for seed in seeds]) for name, seeds in curves.items()
    ][:MOST_LINES]  # fmt: skip
    draw_learning(path, f"{figures['task']}: {best_of(lines, RETURN)}", [Panel("", lines)], RETURN)


def draw_comparison(figures: Mapping[str, Any], path: Path) -> None:
    """Draw returns, or how far they stay below a reference, while methods learnt.

    Args:
        figures: Figures' data of `collect_comparison`.
        path: Path of the picture.
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
    """Draw returns over environment steps, a panel for each task, beside what others publish.

    Args:
        figures: Figures' data of `collect_curves`.
        path: Path of the picture.
    """
    panels: dict[str, list[Line]] = {}
    for method, each in figures["last_policies"].items():
        task = method.removesuffix("_fine")
        panels.setdefault(task, []).append(line_of(method, "the last policy", each["curve"]))
    title = "; ".join(f"{task}: {best_of(lines, RETURN)}" for task, lines in panels.items())
    shown = [
        Panel(task if len(panels) > 1 else "", lines, published=PUBLISHED.get(task, {}))
        for task, lines in panels.items()
    ]
    draw_learning(path, title, shown, RETURN)

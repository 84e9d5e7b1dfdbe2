"""Pictures of comparisons: returns while learning (thesis Fig. 4.8, 4.9), or how far from a reference (4.3)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from ctrl_rl_core.io.file_checks import short_repr
from ctrl_rl_core.io.schema import Name
from ctrl_rl_training.experiments.figure_data import Figures, ValueCurve
from ctrl_rl_training.plots import draw_curve, over_seeds
from matplotlib import pyplot as plt
from pydantic import Field, model_validator

from ctrl_rl_core import save_figure
from koopman_lqr_controller.training.experiments.methods import METHODS

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
    ax.set_xlabel("steps of the system [thousands]")
    ax.set_ylabel("reference return less ours" if gaps else "return")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
    seeds = max(len(curve["values"]) for curve in figures["curves"].values())
    ax.set_title(f"{figures['task']}: {over_seeds(seeds)}", fontsize=10)
    save_figure(figure, path)

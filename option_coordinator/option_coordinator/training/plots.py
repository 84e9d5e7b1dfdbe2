"""Pictures of learning joint options: the curves of Fig. 5.4."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from ctrl_rl_core.io.schema import Name
from ctrl_rl_training.experiments.figure_data import Figures, ValueCurve
from ctrl_rl_training.plots import draw_curve, over_seeds
from matplotlib import pyplot as plt
from matplotlib.ticker import ScalarFormatter, SymmetricalLogLocator
from pydantic import Field

from ctrl_rl_core import save_figure
from option_coordinator.training.experiments.methods import METHODS

_COLOURS = (
    "tab:red",
    "tab:orange",
    "tab:green",
    "tab:purple",
    "tab:blue",
    "tab:cyan",
    "0.5",
    "tab:brown",
    "tab:pink",
    "tab:olive",
)


class Learning(Figures):
    """What curves are drawn from, see `results.collect`."""

    metric: Name
    scripted: float
    curves: Annotated[dict[str, ValueCurve], Field(max_length=100)]


def draw_curves(figures: Mapping[str, Any], path: Path) -> None:
    """Draw what episodes of learning gave against low-level samples: mean and standard deviation over the seeds."""
    figure, ax = plt.subplots(figsize=(9.0, 4.2), layout="constrained")
    for name, colour in zip(METHODS, _COLOURS, strict=True):
        if name in figures["curves"] and not METHODS[name].budget:  # who takes longer would squeeze the others
            curve = figures["curves"][name]
            draw_curve(ax, curve["samples"], curve["values"], METHODS[name].label, colour, start=None)
    ax.axhline(figures["scripted"], color="k", linewidth=0.8, linestyle=":", label="scripted")
    ax.set_xlabel("low-level samples [thousands]")
    ax.set_ylabel(figures["metric"])
    if figures["scripted"] < 0.0:  # where nothing is above 0, orders of magnitude lie between first and last
        ax.set_yscale("symlog", linthresh=0.5 * abs(figures["scripted"]))
        ax.set_ylim(top=0.5 * figures["scripted"])
        ax.yaxis.set_major_locator(SymmetricalLogLocator(base=10.0, linthresh=1.0, subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(ScalarFormatter())
    ax.grid(alpha=0.3)
    seeds = max((len(curve["values"]) for curve in figures["curves"].values()), default=0)
    ax.set_title(f"{figures['task']}: {over_seeds(seeds)}", fontsize=10)
    figure.legend(loc="outside right upper", fontsize=8)
    save_figure(figure, path)

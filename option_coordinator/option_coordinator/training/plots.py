"""Figures on learning joint options: the curves of Fig. 5.4."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from ctrl_rl_core.io import Name
from ctrl_rl_core.plots import MOST_LINES, Panel, best_of, draw_learning, line_of
from ctrl_rl_learning.study import Figures, ValueCurve
from pydantic import Field

from option_coordinator.training.experiments.methods import METHODS

_FIRST = ("async", "async_autoregressive", "sync_wait", "mac_dqn", "end2end")
"""Methods to draw if there are too many for one figure; the tables contain all."""


class Learning(Figures):
    """Data of the curves, see `results.collect`."""

    metric: Name
    scripted: float
    curves: Annotated[dict[str, ValueCurve], Field(max_length=100)]


def draw_curves(figures: Mapping[str, Any], path: Path) -> None:
    """Draw the return of episodes over environment steps during training."""
    # Methods with larger budgets would compress the others' curves.
    there = [name for name in METHODS if name in figures["curves"] and not METHODS[name].budget]
    chosen = there if len(there) <= MOST_LINES else [name for name in _FIRST if name in there]
    lines = [line_of(name, METHODS[name].label, figures["curves"][name]) for name in chosen]
    scripted = figures["scripted"]
    # All-negative returns span orders of magnitude.
    linear_below = 0.5 * abs(scripted) if scripted < 0.0 else None
    panel = Panel("", lines, {"scripted": scripted})
    title = f"{figures['task']}: {best_of(lines, figures['metric'])}"
    draw_learning(path, title, [panel], figures["metric"], linear_below)

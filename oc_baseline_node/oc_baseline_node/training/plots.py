"""Figures on learning: success (thesis Fig. 3.14), return (3.10, 3.13, 3.16), advantages (3.12), paths (3.9, 3.15)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from ctrl_rl_core.plots import (
    MOST_LINES,
    RETURN,
    SUCCESS,
    Panel,
    Style,
    best_of,
    draw_learning,
    draw_paths,
    line_of,
    name_at_end,
    style_of,
)
from ctrl_rl_learning.study import DrivenPath, Figures, ReturnCurve
from pydantic import Field, model_validator

from ctrl_rl_core import NavigationTask, picture
from oc_baseline_node.training.experiments.methods import GROUPS, METHODS

_MAIN = ("oc_ppo", "oc_corrected", "ppo")
_WITH_AND_WITHOUT = ("oc_ppo", "ppo")
_Range = Annotated[list[float], Field(min_length=3, max_length=3)]
_Updates = Annotated[list[_Range], Field(min_length=1, max_length=100_000)]
_OfSeed = Annotated[list[_Updates], Field(min_length=1, max_length=100_000)]


class Learnt(Figures):
    """Data for figures of learnt paths."""

    curves: dict[str, ReturnCurve]
    paths: dict[str, list[DrivenPath]]


class Learning(Learnt):
    """Data for figures of learning, see `results.collect`."""

    advantages: dict[str, Annotated[list[_OfSeed], Field(min_length=1)]]

    @model_validator(mode="after")
    def _of_one_size(self) -> Learning:
        for name, seeds in self.advantages.items():
            length = min(len(seed) for seed in seeds)
            if len({sum(len(updates) for updates in seed[:length]) for seed in seeds}) > 1:
                raise ValueError(f"advantages.{name}: seeds of different sizes")
        return self


def draw_all(figures: Mapping[str, Any], task: NavigationTask, folder: Path) -> Iterator[Path]:
    """Draw all figures of a task's results and return their files; methods without runs are omitted."""
    for group, methods in GROUPS.items():
        there = [name for name in METHODS if name in methods and name in figures["curves"]]
        if len(there) > 1 and (group == "ablation" or not set(there) <= set(_MAIN)):
            yield from draw_curves(figures, there, folder / f"{task.name}_oc_{group}.svg")
    if any(name in figures["advantages"] for name in _WITH_AND_WITHOUT):
        yield draw_advantages(figures, folder / f"{task.name}_oc_advantages.svg")
    panels = {METHODS[name].label: figures["paths"][name] for name in _MAIN if name in figures["paths"]}
    if panels:
        path = folder / f"{task.name}_oc_paths.png"
        draw_paths(path, f"{task.name}: paths after learning", task, panels)
        yield path


def draw_curves(figures: Mapping[str, Any], methods: Sequence[str], path: Path) -> Iterator[Path]:
    """Draw success and return of methods during training, and return the two files."""
    for key, measure, file in (("success", SUCCESS, path), ("total", RETURN, path.with_stem(f"{path.stem}_return"))):
        lines = [line_of(name, METHODS[name].label, figures["curves"][name], key) for name in methods]
        draw_learning(file, f"{figures['task']}: {best_of(lines, measure)}", [Panel("", lines[:MOST_LINES])], measure)
        yield file


def draw_advantages(figures: Mapping[str, Any], path: Path) -> Path:
    """Draw the 5 to 95 % range of each roll-out's advantages, with and without V_oc (Fig. 3.12)."""
    ranges = {}
    for name in _WITH_AND_WITHOUT:
        seeds = figures["advantages"].get(name)
        if seeds is not None:
            length = min(len(seed) for seed in seeds)
            ranges[name] = np.mean([np.concatenate(seed[:length]) for seed in seeds], axis=0)
    widths = " and ".join(f"{np.mean(each[:, 2] - each[:, 0]):.1f} with {METHODS[name].label}"
                          for name, each in ranges.items())  # fmt: skip
    with picture(path, f"{figures['task']}: 90 % of the advantages span {widths}") as (_, ((ax,),)):
        taken: dict[str, Style] = {}
        for name, each in ranges.items():
            taken[name] = style_of(name, taken)
            colour, updates = taken[name].colour, np.arange(1, len(each) + 1)
            ax.plot(updates, each[:, 1], color=colour, linestyle=taken[name].line)
            ax.fill_between(updates, each[:, 0], each[:, 2], color=colour, alpha=0.2, linewidth=0)
            name_at_end(ax, f"{METHODS[name].label}\n(n = {len(figures['advantages'][name])})", each[-1, 1], colour)
        ax.set_xlabel("update of the policy")
        ax.set_ylabel("advantage")
    return path

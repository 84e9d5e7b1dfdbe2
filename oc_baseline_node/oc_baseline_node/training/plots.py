"""Pictures of learning: success (thesis Fig. 3.14), return (3.10, 3.13, 3.16), advantages (3.12), paths (3.9, 3.15)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from ctrl_rl_training.experiments.figure_data import DrivenPath, Figures, ReturnCurve
from ctrl_rl_training.plots import draw_curve, draw_paths
from matplotlib import pyplot as plt
from pydantic import Field, model_validator

from ctrl_rl_core import NavigationTask, draw_map, position_indices, save_figure
from oc_baseline_node.training.experiments.methods import GROUPS, METHODS

_COLOURS = {"oc_ppo": "tab:red", "oc_corrected": "tab:blue", "ppo": "0.3"}
_OTHERS = ("tab:orange", "tab:green", "tab:purple", "tab:brown", "tab:cyan", "tab:olive", "tab:pink")
_WITH_AND_WITHOUT = ("oc_ppo", "ppo")
_Range = Annotated[list[float], Field(min_length=3, max_length=3)]
_Updates = Annotated[list[_Range], Field(min_length=1, max_length=100_000)]
_OfSeed = Annotated[list[_Updates], Field(min_length=1, max_length=100_000)]


class Learnt(Figures):
    """What learnt paths are drawn from."""

    curves: dict[str, ReturnCurve]
    paths: dict[str, list[DrivenPath]]


class Learning(Learnt):
    """What is drawn of learning, see `results.collect`."""

    advantages: dict[str, Annotated[list[_OfSeed], Field(min_length=1)]]

    @model_validator(mode="after")
    def _of_one_size(self) -> Learning:
        for name, seeds in self.advantages.items():
            length = min(len(seed) for seed in seeds)
            if len({sum(len(updates) for updates in seed[:length]) for seed in seeds}) > 1:
                raise ValueError(f"advantages.{name}: seeds of different sizes")
        return self


def draw_all(figures: Mapping[str, Any], task: NavigationTask, folder: Path) -> Iterator[Path]:
    """Draw what the results of a task hold and return the files; methods that were not run are left out."""
    for group, methods in GROUPS.items():
        there = [name for name in methods if name in figures["curves"]]
        if len(there) > 1 and (group == "ablation" or not set(there) <= set(_COLOURS)):
            yield draw_curves(figures, there, folder / f"{task.name}_oc_{group}.png")
    if any(name in figures["advantages"] for name in _WITH_AND_WITHOUT):
        yield draw_advantages(figures, folder / f"{task.name}_oc_advantages.png")
    for name in _COLOURS:
        if name in figures["paths"]:
            path = folder / f"{task.name}_{name}_paths.png"
            draw_paths(figures["paths"][name], task, f"{task.name}: learnt with {METHODS[name].label}", path)
            yield path


def draw_curves(figures: Mapping[str, Any], methods: Sequence[str], path: Path) -> Path:
    """Draw success and return of some methods against samples: mean over the seeds, and spread of the main ones."""
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 4.2), layout="constrained")
    others = iter(_OTHERS)
    for name in methods:
        curve, main = figures["curves"][name], name in _COLOURS
        colour = _COLOURS[name] if main else next(others)
        for ax, key, start in ((axes[0], "success", 0.0), (axes[1], "total", None)):
            width = 2.2 if main else 1.3
            draw_curve(ax, curve["samples"], curve[key], METHODS[name].label, colour, width, start, band=main)
    for ax, label in zip(axes, ("success rate", "return"), strict=True):
        ax.set_xlabel("samples [thousands]")
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
    axes[0].set_ylim(-0.02, 1.02)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    seeds = max(len(figures["curves"][name]["success"]) for name in methods)
    figure.suptitle(
        f"{figures['task']}: evaluations while learning, mean of {seeds} seeds; bands: standard deviation", fontsize=10
    )
    save_figure(figure, path)
    return path


def draw_advantages(figures: Mapping[str, Any], path: Path) -> Path:
    """Draw the range of advantages, 5 to 95 % of each roll-out, with and without V_oc (Fig. 3.12)."""
    figure, ax = plt.subplots(figsize=(5.6, 3.6), layout="constrained")
    for name in _WITH_AND_WITHOUT:
        colour, seeds = _COLOURS[name], figures["advantages"].get(name)
        if seeds is None:
            continue
        length = min(len(seed) for seed in seeds)
        low, middle, high = np.mean([np.concatenate(seed[:length]) for seed in seeds], axis=0).T
        updates = np.arange(1, len(low) + 1)
        ax.plot(updates, middle, color=colour, label=METHODS[name].label)
        ax.fill_between(updates, low, high, color=colour, alpha=0.25, linewidth=0)
    ax.set_xlabel("update of the policy")
    ax.set_ylabel("advantage, before standardising")
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)
    ax.set_title(f"{figures['task']}: median and 5 to 95 % of the advantages", fontsize=10)
    save_figure(figure, path)
    return path


_DRIVES = {"MPC": "tab:green", "learnt": "tab:blue"}


def draw_drives(paths: Mapping[str, Sequence[Mapping[str, Any]]], task: NavigationTask, path: Path) -> None:
    """Draw the paths of controllers, by name, each with how it ended."""
    plane = position_indices(task.system.build().state_names)
    figure, ax = plt.subplots(figsize=(5.0, 5.0), layout="constrained")
    draw_map(ax, task)
    for controller, entries in paths.items():
        for index, entry in enumerate(entries):
            x, y = np.array(entry["states"])[:, plane].T
            label = f"{controller}: {', '.join(each['outcome'].lower() for each in entries)}" if index == 0 else None
            ax.plot(x, y, color=_DRIVES[controller], linewidth=1.4, label=label)
            ax.plot(x[-1], y[-1], "x" if entry["outcome"] == "COLLISION" else "o", color=_DRIVES[controller])
    ax.set_title(f"{task.name}: in the simulator", fontsize=10)
    ax.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path)

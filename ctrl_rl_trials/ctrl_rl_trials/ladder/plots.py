"""The figures of the ladder: success while learning, and what all seeds came to at the end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.plots import Panel, draw_ends, draw_learning, line_of

from ctrl_rl_trials.shaping.variants import WAYS

_COMPARED = {"best_progress": "best progress", "distance": "distance", "sparse": "sparse"}
"""Ways that all tasks are learnt with from the same seeds, and their names in the figure; the others are in tables."""
_SEEDS = 3
"""Seeds below which a task is left to the tables."""
_LEARNT = 0.9
"""Success of a task that counts as learnt."""


def draw_ladder(figures: Mapping[str, Any], learner: str, folder: Path) -> list[Path]:
    """Draw the main ways with a learner while they learn, and what their seeds came to; return the files."""
    curves = {
        tuple(name.removesuffix(f", {learner}").split(": ")): curve
        for name, curve in figures["curves"].items()
        if name.endswith(f", {learner}")
    }
    tasks = [
        task for (task, way), curve in curves.items() if way == "best_progress" and len(curve["success"]) >= _SEEDS
    ]
    ends = {
        way: {_words(task): [100.0 * seed[-1] for seed in curves[task, way]["success"]] for task in tasks
              if (task, way) in curves} for way in _COMPARED
    }  # fmt: skip
    learnt = {way: sum(np.mean(seeds) >= 100.0 * _LEARNT for seeds in each.values()) for way, each in ends.items()}
    told = ", ".join(f"{name} {learnt[way]}" for way, name in _COMPARED.items() if ends[way])
    title = f"{learner.upper()} learns, of {len(tasks)} tasks: {told}"
    panels = [
        Panel(_words(task), [line_of(way, name, curves[task, way], "success") for way, name in _COMPARED.items()
                             if (task, way) in curves])
        for task in tasks
    ]  # fmt: skip
    out = [folder / f"ladder_{learner}.svg", folder / f"ladder_{learner}_ends.svg"]
    draw_learning(out[0], title, panels)
    draw_ends(out[1], title, ends, {way: WAYS[way].label if len(name) < 9 else name for way, name in _COMPARED.items()})
    return out


def _words(task: str) -> str:
    return task.replace("_", " ")

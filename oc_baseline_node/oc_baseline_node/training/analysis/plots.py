"""The plot of thesis Fig. 3.17: MPC with its model in the simulator, beside the learned policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from ctrl_rl_core import NavigationTask, draw_map, position_indices, save_figure

_COLOURS = {"MPC": "tab:green", "learnt": "tab:blue"}


def draw_paths(paths: Mapping[str, Sequence[Mapping[str, Any]]], task: NavigationTask, path: Path) -> None:
    """Draw the paths of controllers, by name, each with how it ended."""
    plane = position_indices(task.system.build().state_names)
    figure, ax = plt.subplots(figsize=(5.0, 5.0), layout="constrained")
    draw_map(ax, task)
    for controller, entries in paths.items():
        for index, entry in enumerate(entries):
            x, y = np.array(entry["states"])[:, plane].T
            label = f"{controller}: {', '.join(each['outcome'].lower() for each in entries)}" if index == 0 else None
            ax.plot(x, y, color=_COLOURS[controller], linewidth=1.4, label=label)
            ax.plot(x[-1], y[-1], "x" if entry["outcome"] == "COLLISION" else "o", color=_COLOURS[controller])
    ax.set_title(f"{task.name}: in the simulator", fontsize=10)
    ax.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path)

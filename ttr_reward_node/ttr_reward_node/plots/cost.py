"""Plot of the cost of solutions as the grid grows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from ctrl_rl_core import save_figure
from ttr_reward_node.verification.cost import exponent


def draw_cost(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw CPU seconds over points for each system, with both axes logarithmic, beside a line of slope one.

    Args:
        rows: Rows of `measure_cost` for one method.
        path: File of the picture; replaced if it exists.
    """
    figure, axes = plt.subplots(figsize=(7.6, 4.8), layout="constrained")
    for name in dict.fromkeys(row["system"] for row in rows):
        mine = [row for row in rows if row["system"] == name]
        points, seconds = (np.array([row[key] for row in mine]) for key in ("points", "cpu_s"))
        slope = f" (exponent {exponent(mine):.2f})" if np.sum(points >= 9e3) > 1 else ""
        axes.loglog(points, seconds, marker="o", markersize=3, linewidth=1.2, label=f"{name}{slope}")
    points = np.array([min(row["points"] for row in rows), max(row["points"] for row in rows)], dtype=np.float64)
    middle = np.exp(np.mean(np.log([row["cpu_s"] / row["points"] for row in rows if row["points"] > 1e4])))
    axes.loglog(points, middle * points, color="0.5", linestyle="--", linewidth=1.0, label="linear in the points")
    axes.set_xlabel("grid points")
    axes.set_ylabel("CPU time [s]")
    axes.grid(which="major", color="0.9")
    axes.legend(fontsize=7.5)
    axes.set_title(
        f"time to reach, {rows[0]['method'].replace('_', '-')}: cost of systems of 1 to 6 dimensions", fontsize=10
    )
    save_figure(figure, path)

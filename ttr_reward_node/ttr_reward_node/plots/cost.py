"""Plot of the solution cost over the grid size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.plots import BLACK, FAINT, MOST_LINES, ROBOTS, name_at_end, picture

from ttr_reward_node.verification.cost import exponent

_LOOKS = tuple(zip((*ROBOTS, BLACK, BLACK), ("o-", "s-", "D-", "^-", "v--"), strict=True))
"""Colour and line style of each system; of systems with the same number of states, the first is drawn."""


def draw_cost(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Plot CPU seconds over grid points for each system on logarithmic axes, with a reference line of slope one.

    Args:
        rows: Rows of `measure_cost` for one method.
        path: Figure file; replaced if it exists.
    """
    largest = max(row["points"] for row in rows)
    with picture(path, f"Time to reach, {rows[0]['method'].replace('_', '-')}: CPU time grows with the points, up to "
                 f"{largest / 1e6:.1f} million of them", height=3.4) as (_, ((axes,),)):  # fmt: skip
        first = {name.partition("D")[0]: name for name in reversed([row["system"] for row in rows])}
        for name, (colour, line) in zip(sorted(first.values())[-MOST_LINES:], _LOOKS, strict=False):
            mine = [row for row in rows if row["system"] == name]
            points, seconds = (np.array([row[key] for row in mine]) for key in ("points", "cpu_s"))
            slope = f" (exponent {exponent(mine):.2f})" if np.sum(points >= 9e3) > 1 else ""
            axes.plot(points, seconds, line, color=colour, markersize=4)
            name_at_end(axes, f"{name}{slope}", float(seconds[-1]), colour)
        points = np.array([min(row["points"] for row in rows), largest], dtype=np.float64)
        middle = np.exp(np.mean(np.log([row["cpu_s"] / row["points"] for row in rows if row["points"] > 1e4])))
        axes.plot(points, middle * points, color=FAINT, linewidth=0.8)
        name_at_end(axes, "linear in the points", float(middle * points[-1]), FAINT)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("grid points")
        axes.set_ylabel("CPU time [s]")

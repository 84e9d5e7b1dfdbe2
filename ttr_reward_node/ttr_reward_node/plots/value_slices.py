"""Plots of a time-to-reach function: slices through it (thesis Fig. 3.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.tasks.regions import ANGLES
from ctrl_rl_core.values.plane import plane_of
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, ValueFunction, draw_world, save_figure
from ttr_reward_node.errors import TimeToReachError

Array = NDArray[np.float64]
_POINTS = 300
_THESIS_HEADINGS = (-np.pi / 4, 0.0, np.pi / 2, 3 * np.pi / 4)


def draw_slices(
    function: ValueFunction,
    task: NavigationTask,
    path: Path,
    at: Mapping[str, Sequence[float]] | None = None,
) -> None:
    """Draw the time to reach over the plane, one picture for each value of one other component, as Fig. 3.1 does.

    Args:
        function: Time to reach over x, y or x, z and more states.
        task: Task with the goal and obstacles to draw.
        path: File of the picture; replaced if it exists.
        at: Values of the other components by name [their unit]; the one with more than one value makes the panels.
            Unless given, the thesis's four headings for the robot's angle, and 0 for the rest.

    Raises:
        TimeToReachError: two components have several values.
        ValueFunctionError: there is no plane of positions, or `at` names what the state lacks.
    """
    plane = plane_of(function)
    first, second = plane.first, plane.second
    values = _panels(plane.others, at or {})
    x, y = np.linspace(first.lower, first.upper, _POINTS), np.linspace(second.lower, second.upper, _POINTS)
    slices = [function.value(plane.states(x, y, panel)) for panel in values]
    finite = [layer[np.isfinite(layer)] for layer in slices]
    top = max((float(layer.max()) for layer in finite if layer.size), default=1.0)
    figure, axes = plt.subplots(
        1, len(values), figsize=(4.2 * len(values) + 0.8, 4.4), sharey=True, squeeze=False, layout="constrained"
    )
    image: Any = None
    for panel, layer, ax in zip(values, slices, axes[0], strict=True):
        levels = np.linspace(0.0, top, 25)
        image = ax.contourf(x, y, np.ma.masked_invalid(layer), levels, cmap="viridis_r", extend="max")
        draw_world(ax, task)
        ax.set_title(", ".join(f"{name} = {value:.3g}" for name, value in panel.items()), fontsize=9)
        ax.set_xlabel(f"{first.name} [{first.unit}]")
        ax.set_xlim(first.lower, first.upper)
        ax.set_ylim(second.lower, second.upper)
        ax.set_facecolor("0.85")
    axes[0, 0].set_ylabel(f"{second.name} [{second.unit}]")
    figure.colorbar(image, ax=list(axes[0]), label="time to reach [s]", shrink=0.85)
    figure.suptitle(f"{task.name}: time to reach; grey cannot reach the goal", fontsize=11)
    save_figure(figure, path)


def _panels(others: Sequence[str], at: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """Return the values that each panel fixes, by component."""
    angle = next((name for name in others if name in ANGLES), None)
    defaults = {name: _THESIS_HEADINGS if name == angle and not at else (0.0,) for name in others}
    fixed = {**defaults, **at}
    many = [name for name, values in fixed.items() if len(values) > 1]
    if len(many) > 1:
        raise TimeToReachError(f"{' and '.join(many)} have several values each: only one component makes panels")
    count = len(fixed[many[0]]) if many else 1
    return [{name: values[index if len(values) > 1 else 0] for name, values in fixed.items()} for index in range(count)]

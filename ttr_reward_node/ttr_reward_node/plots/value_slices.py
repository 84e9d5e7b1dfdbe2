"""Plots of a time-to-reach function, or of a safety value: slices through it (thesis Fig. 3.1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.tasks.regions import ANGLES
from ctrl_rl_core.values.plane import plane_of
from matplotlib import pyplot as plt
from matplotlib.colors import Normalize, TwoSlopeNorm
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, ValueFunction, draw_world, save_figure
from ttr_reward_node.errors import TimeToReachError

Array = NDArray[np.float64]
_POINTS = 300
_THESIS_HEADINGS = (-np.pi / 4, 0.0, np.pi / 2, 3 * np.pi / 4)


@dataclass(frozen=True)
class _Style:
    """Colours and words of a kind of value."""

    label: str
    title: str
    colours: str
    norm: Callable[[float, float], Normalize]


_TIME = _Style("time to reach [s]", "time to reach; grey cannot reach the goal", "viridis_r", Normalize)
_SAFETY = _Style(
    "safety value [m]",
    "safety value; inside the black line all can be avoided",
    "RdYlGn",
    lambda low, top: TwoSlopeNorm(0.0, low, top),
)


def draw_slices(
    function: ValueFunction,
    task: NavigationTask,
    path: Path,
    at: Mapping[str, Sequence[float]] | None = None,
) -> None:
    """Draw the values over the plane, one picture for each value of one other component, as Fig. 3.1 does.

    The edge of a safe set is a black line.

    Args:
        function: Time to reach or safety value over x, y or x, z and more states.
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
    finite = np.concatenate([layer[np.isfinite(layer)] for layer in slices])
    style = _SAFETY if function.kind in ("avoid", "reach_avoid") else _TIME
    top = max(float(finite.max(initial=0.0)), 1e-6)
    low = min(float(finite.min(initial=0.0)), -1e-6) if style is _SAFETY else 0.0
    figure, axes = plt.subplots(
        1, len(values), figsize=(4.2 * len(values) + 0.8, 4.4), sharey=True, squeeze=False, layout="constrained"
    )
    image: Any = None
    for panel, layer, ax in zip(values, slices, axes[0], strict=True):
        shown = np.ma.masked_invalid(layer)
        image = ax.contourf(x, y, shown, np.linspace(low, top, 25), cmap=style.colours, norm=style.norm(low, top))
        if style is _SAFETY and layer.min() < 0.0 < layer.max():
            ax.contour(x, y, shown, [0.0], colors="black", linewidths=1.5)
        draw_world(ax, task)
        ax.set_title(", ".join(f"{name} = {value:.3g}" for name, value in panel.items()), fontsize=9)
        ax.set_xlabel(f"{first.name} [{first.unit}]")
        ax.set_xlim(first.lower, first.upper)
        ax.set_ylim(second.lower, second.upper)
        ax.set_facecolor("0.85")
    axes[0, 0].set_ylabel(f"{second.name} [{second.unit}]")
    figure.colorbar(image, ax=list(axes[0]), label=style.label, shrink=0.85)
    figure.suptitle(f"{task.name}: {style.title}", fontsize=11)
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

"""Plots of slices through a time-to-reach function or a safety value (thesis Fig. 3.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.plots import draw_values, draw_world, name_axes, named_value, picture
from ctrl_rl_core.tasks import ANGLES
from ctrl_rl_core.values import plane_of

from ctrl_rl_core import NavigationTask, ValueFunction
from ttr_reward_node.errors import TimeToReachError

_POINTS, _MOST = 300, 6
_THESIS_HEADINGS = (-np.pi / 4, 0.0, np.pi / 2, 3 * np.pi / 4)


def draw_slices(
    function: ValueFunction,
    task: NavigationTask,
    path: Path,
    at: Mapping[str, Sequence[float]] | None = None,
) -> None:
    """Plot the values over the plane, one panel per value of one other component, as in Fig. 3.1.

    The boundary of a safe set is a black line.

    Args:
        function: Time to reach or safety value over x, y or x, z and further states.
        task: Task with the goal and obstacles to draw.
        path: Figure file; replaced if it exists.
        at: Values of the other components by name [their unit]; the component with several values makes the panels.
            Default: the thesis's four headings for the robot's angle, and 0 for the others.

    Raises:
        TimeToReachError: Two components have several values.
        ValueFunctionError: There is no plane of positions, or `at` names a component that is not in the state.
    """
    plane = plane_of(function)
    first, second = plane.first, plane.second
    values = _panels(plane.others, at or {})
    x, y = np.linspace(first.lower, first.upper, _POINTS), np.linspace(second.lower, second.upper, _POINTS)
    slices = [function.value(plane.states(x, y, panel)) for panel in values]
    finite = np.concatenate([layer[np.isfinite(layer)] for layer in slices])
    safety = function.kind in ("avoid", "reach_avoid")
    span = (float(finite.min(initial=0.0)) if safety else 0.0, max(float(finite.max(initial=0.0)), 1e-6))
    title = "inside the black line all can be avoided" if safety else f"at most {span[1]:.0f} s to the goal"
    columns = min(len(values), 2)
    rows = -(-min(len(values), _MOST) // columns)
    with picture(path, f"{task.name}: {title}", rows, columns, height=0.7 + 2.9 * rows, sharex=True,
                 sharey=True) as (figure, axes):  # fmt: skip
        for ax in axes.flat[len(values) :]:
            ax.set_axis_off()
        image: Any = None
        for panel, layer, ax in zip(values, slices, axes.flat, strict=False):
            image = draw_values(ax, x, y, layer, "signed" if safety else "time", span)
            draw_world(ax, task)
            ax.set_title(", ".join(named_value(name, value) for name, value in panel.items()))
            ax.set_xlim(first.lower, first.upper)
            ax.set_ylim(second.lower, second.upper)
            name_axes(ax, first.name, second.name)
            ax.label_outer()
        figure.colorbar(image, ax=list(axes.flat), label="safety value [m]" if safety else "time to reach [s]")


def _panels(others: Sequence[str], at: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """Return the fixed values of each panel, by component."""
    angle = next((name for name in others if name in ANGLES), None)
    defaults = {name: _THESIS_HEADINGS if name == angle and not at else (0.0,) for name in others}
    fixed = {**defaults, **at}
    many = [name for name, values in fixed.items() if len(values) > 1]
    if len(many) > 1:
        raise TimeToReachError(f"{' and '.join(many)} have several values each: only one component makes panels")
    count = len(fixed[many[0]]) if many else 1
    return [{name: values[index if len(values) > 1 else 0] for name, values in fixed.items()} for index in range(count)]

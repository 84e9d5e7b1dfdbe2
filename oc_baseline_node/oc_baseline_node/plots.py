"""Plots: the value heat map (thesis Fig. 3.11) and trajectories among obstacles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from ctrl_rl_core.plots import draw_values, named_value, word_at
from ctrl_rl_core.values import plane_of
from numpy.typing import NDArray

from ctrl_rl_core import Axis, NavigationTask, ValueFunction, draw_map, draw_path, picture, position_indices
from oc_baseline_node.errors import OcError

Array = NDArray[np.float64]
_CELLS = 300


def draw_heat_map(
    value: ValueFunction, task: NavigationTask, path: Path, at: Mapping[str, float] | None = None, cells: int = _CELLS
) -> Array:
    """Draw V_oc over the plane of positions (Fig. 3.11); return its values (cells, cells), rows along y or z.

    Colours span the values in free space; collisions are hatched.

    Args:
        value: Value function over the states of the task's system.
        task: Task with the arena, goal and obstacles to draw.
        path: PNG file to write.
        at: Values of the other state components in their units; 0 by default.
        cells: Number of cells along each side of the map.

    Raises:
        OcError: The value has other states than the task.
        ValueFunctionError: `at` names an unknown state component.
        OSError: The figure cannot be written.
    """
    plane, chosen = plane_of(value), dict(at or {})
    if value.state_names != task.system.build().state_names:
        raise OcError(f"the value's states {', '.join(value.state_names)} are not those of task '{task.name}'")
    first, second = plane.first, plane.second
    states = plane.states(_centres(first, cells), _centres(second, cells), chosen)
    values = value.value(states)
    free = np.where(values > task.rewards.collision + 1e-6, values, np.nan)
    title = f"{task.name}: " + ", ".join(named_value(name, chosen.get(name, 0.0)) for name in plane.others)
    with picture(path, title, height=4.6) as (figure, ((axes,),)):
        draw_map(axes, task)
        shown = draw_values(axes, _centres(first, cells), _centres(second, cells), free, "return")
        figure.colorbar(shown, label="$V^{oc}$ [reward]")
    return values


def draw_trajectories(task: NavigationTask, states: Sequence[Array], path: Path) -> None:
    """Draw planned trajectories (each (H+1, n)) among the task's obstacles."""
    place = position_indices(task.system.build().state_names)
    with picture(path, height=3.6, half=True) as (_, ((axes,),)):
        draw_map(axes, task)
        for trajectory in states:
            draw_path(axes, trajectory[:, place], planned=True)
            word_at(axes, "start", (float(trajectory[0, place[0]]), float(trajectory[0, place[1]])))


def _centres(axis: Axis, cells: int) -> Array:
    return axis.lower + (np.arange(cells) + 0.5) * (axis.upper - axis.lower) / cells

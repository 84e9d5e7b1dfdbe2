"""Pictures: the value heat map (thesis Fig. 3.11) and trajectories among obstacles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.geometry import Box, Disc
from ctrl_rl_core.regions import Region, position_indices
from ctrl_rl_core.tasks import NavigationTask
from ctrl_rl_core.value_function import ValueFunction
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from oc_baseline_node.errors import OcError

Array = NDArray[np.float64]
_CELLS = 300
_COLLISION = "#c6d3e3"


def heat_map(
    value: ValueFunction, task: NavigationTask, path: Path, at: Mapping[str, float] | None = None, cells: int = _CELLS
) -> Array:
    """Draw V_oc over the plane of positions (Fig. 3.11) and return what is drawn (cells, cells), rows along y or z.

    Colours span the values of the free space; where the body collides the map is pale.

    Args:
        value: over the states of the task's system.
        task: whose arena, goal and obstacles are drawn.
        path: of the picture, its suffix tells the format.
        at: the other state components [their unit]; 0 where left out.
        cells: a side.

    Raises:
        OcError: the value belongs to another kind of state, or `at` names what it lacks.
    """
    names, chosen = value.state_names, dict(at or {})
    if task.arena is None or names != task.system.build().state_names:
        raise OcError(f"the value's states {', '.join(names)} are not those of task '{task.name}'")
    unknown = set(chosen) - set(names)
    if unknown:
        raise OcError(f"'{min(unknown)}' is no component of the state: there are {', '.join(names)}")
    first, second = task.arena.bounds
    states = np.zeros((cells, cells, len(names)))
    for name, number in chosen.items():
        states[..., names.index(name)] = number
    place = position_indices(names)
    states[..., place[0]] = _centres(first.low, first.high, cells)
    states[..., place[1]] = _centres(second.low, second.high, cells)[:, None]
    values = value.value(states)
    free = np.where(values > task.rewards.collision + 1e-6, values, np.nan)
    figure = Figure(figsize=(6.4, 5.4), layout="constrained")
    axes = figure.add_subplot()
    axes.set_facecolor(_COLLISION)
    shown = axes.imshow(free, origin="lower", extent=(*first, *second), cmap="YlOrRd", interpolation="nearest")
    figure.colorbar(shown, label="$V^{oc}$ [reward]")
    rest = [name for index, name in enumerate(names) if index not in place]
    axes.set_title(f"{task.name}: " + ", ".join(f"{name} = {chosen.get(name, 0.0):.3g}" for name in rest), fontsize=10)
    _surroundings(axes, task)
    _save(figure, path)
    return values


def trajectories(task: NavigationTask, states: Sequence[Array], path: Path) -> None:
    """Draw trajectories (each (H+1, n)) among the task's obstacles."""
    place = position_indices(task.system.build().state_names)
    figure = Figure(figsize=(5.6, 5.4), layout="constrained")
    axes = figure.add_subplot()
    for trajectory in states:
        x, y = trajectory[:, place].T
        axes.plot(x, y, ".-", markersize=3, linewidth=1)
        axes.plot(x[0], y[0], "ko", markersize=4)
    assert task.arena is not None
    axes.set_xlim(*task.arena.bounds[0])
    axes.set_ylim(*task.arena.bounds[1])
    _surroundings(axes, task)
    _save(figure, path)


def _surroundings(axes: Any, task: NavigationTask) -> None:
    for shape in task.build_world().obstacles:
        _outline(axes, shape, facecolor="none", edgecolor="black", hatch="////")
    for region, colour in ((task.goal.region, "green"), (None if task.trap is None else task.trap.region, "purple")):
        if region is not None:
            _outline(axes, _shape_of(region, task.plane), facecolor="none", edgecolor=colour, linewidth=2)
    axes.set_xlabel("x [m]")
    axes.set_ylabel(f"{task.plane[1]} [m]")
    axes.set_aspect("equal")


def _shape_of(region: Region, plane: str) -> Box | Disc:
    if region.disc is not None:
        return region.disc
    intervals = [region.intervals[name] for name in plane]
    return Box(region.position, (intervals[0].length, intervals[1].length))


def _outline(axes: Any, shape: Box | Disc, **style: Any) -> None:
    if isinstance(shape, Disc):
        axes.add_patch(Circle(shape.centre, shape.radius, **style))
        return
    corner = (shape.centre[0] - 0.5 * shape.size[0], shape.centre[1] - 0.5 * shape.size[1])
    degrees = float(np.degrees(shape.angle))
    axes.add_patch(Rectangle(corner, *shape.size, angle=degrees, rotation_point="center", **style))


def _centres(low: float, high: float, cells: int) -> Array:
    return low + (np.arange(cells) + 0.5) * (high - low) / cells


def _save(figure: Figure, path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=120)
    except (OSError, ValueError) as error:
        raise OcError(f"cannot write {path}: {error}") from None

"""Pictures of a time-to-reach function: slices through it (thesis Fig. 3.1), its optimal paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.drawing import draw_world, save_figure
from ctrl_rl_core.grid_axis import Axis
from ctrl_rl_core.regions import ANGLES, position_indices
from ctrl_rl_core.tasks import NavigationTask
from ctrl_rl_core.value_function import ValueFunction
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from ttr_reward_node.errors import TimeToReachError

Array = NDArray[np.float64]
_POINTS = 300
_THESIS_HEADINGS = (-np.pi / 4, 0.0, np.pi / 2, 3 * np.pi / 4)


def draw_slices(
    function: ValueFunction,
    task: NavigationTask,
    path: Path,
    at: Mapping[str, Sequence[float]] | None = None,
    roll_outs: Sequence[Array] = (),
) -> None:
    """Draw the time to reach over the plane, one picture for each value of one other component, as Fig. 3.1 does.

    Args:
        function: time to reach over x, y or x, z and more.
        task: whose goal and obstacles are drawn too.
        path: of the picture; replaced if it exists.
        at: values of the other components by name [their unit]; the one with more than one value makes the panels.
            The thesis's four headings for the robot's angle, and 0 for the rest, unless given.
        roll_outs: paths (n, states) to draw on top of every panel.

    Raises:
        TimeToReachError: there is no plane of positions, or `at` names what the state lacks.
    """
    names = function.state_names
    plane = position_indices(names)
    if len(plane) < 2:
        raise TimeToReachError(f"the states {', '.join(names)} have no plane of positions to draw")
    values = _panels(names, plane, at or {})
    first, second = (_axis(function, names[index]) for index in plane)
    x, y = np.linspace(first.lower, first.upper, _POINTS), np.linspace(second.lower, second.upper, _POINTS)
    slices = [function.value(_states(names, plane, x, y, panel)) for panel in values]
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
        for states in roll_outs:
            ax.plot(states[:, plane[0]], states[:, plane[1]], color="white", linewidth=1.0)
        ax.set_title(", ".join(f"{name} = {value:.3g}" for name, value in panel.items()), fontsize=9)
        ax.set_xlabel(f"{first.name} [{first.unit}]")
        ax.set_xlim(first.lower, first.upper)
        ax.set_ylim(second.lower, second.upper)
        ax.set_facecolor("0.85")
    axes[0, 0].set_ylabel(f"{second.name} [{second.unit}]")
    figure.colorbar(image, ax=list(axes[0]), label="time to reach [s]", shrink=0.85)
    figure.suptitle(f"{task.name}: time to reach; grey cannot reach the goal", fontsize=11)
    save_figure(figure, path)


def _panels(names: Sequence[str], plane: Sequence[int], at: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    others = [name for index, name in enumerate(names) if index not in plane]
    unknown = [name for name in at if name not in others]
    if unknown:
        raise TimeToReachError(f"'{unknown[0]}' cannot be fixed: besides the position there are {', '.join(others)}")
    angle = next((name for name in others if name in ANGLES), None)
    fixed = {name: tuple(at.get(name, _THESIS_HEADINGS if name == angle and not at else (0.0,))) for name in others}
    many = [name for name in others if len(fixed[name]) > 1]
    if len(many) > 1:
        raise TimeToReachError(f"{' and '.join(many)} have several values each: only one component makes panels")
    count = len(fixed[many[0]]) if many else 1
    return [{name: fixed[name][index if len(fixed[name]) > 1 else 0] for name in others} for index in range(count)]


def _states(names: Sequence[str], plane: Sequence[int], x: Array, y: Array, panel: Mapping[str, float]) -> Array:
    out = np.zeros((len(y), len(x), len(names)))
    for name, value in panel.items():
        out[..., names.index(name)] = value
    out[..., plane[0]], out[..., plane[1]] = x, y[:, None]
    return out


def _axis(function: ValueFunction, name: str) -> Axis:
    return next(axis for grid in function.grids for axis in grid.axes if axis.name == name)

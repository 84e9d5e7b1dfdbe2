"""Maps: a task's world, with values or counts drawn over it."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, TwoSlopeNorm
from matplotlib.patches import Circle, Patch, Polygon, Rectangle
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.geometry.shapes import ArcPath, Box, Shape
from ctrl_rl_core.geometry.units import Interval
from ctrl_rl_core.plots.roles import COUNTS, FAINT, GOAL, RETURNS, SIGNED, UNKNOWN, VALUES, WALL
from ctrl_rl_core.plots.words import SOLID, word_at
from ctrl_rl_core.tasks.task import NavigationTask

Array = NDArray[np.float64]
_WALL: dict[str, Any] = {"color": WALL, "linewidth": 0, "zorder": 3, "gid": SOLID}
_GOAL: dict[str, Any] = {
    "facecolor": "none",
    "edgecolor": GOAL,
    "linewidth": 1.6,
    "hatch": "//",
    "zorder": 4,
    "gid": SOLID,
}
_SEEN = {"xy": "seen from above", "xz": "seen from the side"}
_STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
_MOST_CONTOURS = 14


def draw_world(axes: Axes, task: NavigationTask, width: float | None = None, words: bool = True) -> None:
    """Draw walls, obstacles and goal in the task's plane [m].

    Args:
        axes: Axes to draw on.
        task: Task with the world to draw.
        width: Free width of its corridor [m]; None for the task's own.
        words: Whether to write the word "goal".
    """
    world = task.build_world(width)
    for shape in (*world.walls, *world.obstacles):
        axes.add_patch(_solid(shape))
    for patch in _goal(task, world.path, world.width):
        axes.add_patch(patch)
        if words:
            word_at(axes, "goal", _centre(patch), GOAL)
    axes.set_aspect("equal")
    axes.grid(visible=False)


def draw_map(axes: Axes, task: NavigationTask, width: float | None = None, words: bool = True) -> None:
    """Draw the task's world, with axes [m] that span the space within its walls."""
    draw_world(axes, task, width, words)
    (across, sides), (up, height) = task.plane_bounds.items()
    axes.set_xlim(sides)
    axes.set_ylim(height)
    name_axes(axes, across, up)


def name_axes(axes: Axes, across: str, up: str) -> None:
    """Label the axes of a map, including the viewpoint."""
    axes.set_xlabel(f"{across} [m], {_SEEN['x' + up]}")
    axes.set_ylabel(f"{up} [m]")
    axes.set_aspect("equal")


def draw_values(
    axes: Axes,
    across: ArrayLike,
    up: ArrayLike,
    values: ArrayLike,
    kind: str = "time",
    span: tuple[float, float] | None = None,
    step: float | None = None,
) -> Any:
    """Draw values over a map, bright for good ones, with white contours at round steps.

    Args:
        axes: Axes to draw on.
        across: Horizontal coordinates (m,) [m].
        up: Vertical coordinates (n,) [m].
        values: Values (n, m); non-finite ones are hatched.
        kind: "time" (lower is better), "return" (higher is better), or "signed" (centred at 0, with the zero level
            drawn).
        span: Minimum and maximum of the colour scale; None for those of the values.
        step: Contour interval; None to choose a round one.

    Returns:
        The image, for use in a colour bar.
    """
    x, y, shown = np.asarray(across), np.asarray(up), np.ma.masked_invalid(np.asarray(values, dtype=float))
    axes.add_patch(
        Rectangle((0, 0), 1, 1, transform=axes.transAxes, facecolor=UNKNOWN, edgecolor="white", hatch="//", zorder=-1)
    )
    low, high = span or (float(shown.min()), float(shown.max()))
    look: dict[str, Any] = {"cmap": {"time": VALUES, "return": RETURNS, "signed": SIGNED}[kind]}
    if kind == "signed":
        look["norm"] = TwoSlopeNorm(0.0, min(low, -1e-6), max(high, 1e-6))
    else:
        look.update(vmin=low, vmax=high)
    image = axes.pcolormesh(x, y, shown, shading="nearest", rasterized=True, zorder=0, **look)
    if kind == "signed":
        if shown.min() < 0.0 < shown.max():
            axes.contour(x, y, shown, [0.0], colors="black", linewidths=1.5)
    else:
        levels = contour_levels(low, high, step)
        if len(levels) and min(shown.shape) > 1:
            axes.contour(x, y, shown, levels, colors="white", linewidths=0.7)
    axes.grid(visible=False)
    return image


def draw_counts(axes: Axes, across: ArrayLike, up: ArrayLike, counts: ArrayLike, most: float) -> Any:
    """Draw visit counts on a logarithmic scale.

    Args:
        axes: Axes to draw on.
        across: Horizontal cell edges (m + 1,) [m].
        up: Vertical cell edges (n + 1,) [m].
        counts: Counts (n, m).
        most: Count of the darkest cell.

    Returns:
        The image, for use in a colour bar.
    """
    look: dict[str, Any] = {"cmap": COUNTS, "norm": LogNorm(1.0, max(most, 2.0))}
    shown = np.ma.masked_less(np.asarray(counts, dtype=float), 1.0)
    return axes.pcolormesh(np.asarray(across), np.asarray(up), shown, rasterized=True, **look)


def contour_levels(low: float, high: float, step: float | None = None) -> Array:
    """Return contour levels at round steps between two values, few enough to be distinct unless a step is given."""
    step = step or next((step for step in _STEPS if (high - low) / step <= _MOST_CONTOURS), _STEPS[-1])
    levels = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    return levels[(levels > low) & (levels < high)]


def draw_landmark(axes: Axes, name: str, place: ArrayLike) -> None:
    """Mark a position with its name [m]."""
    x, y = np.asarray(place, dtype=float)
    axes.plot(x, y, "s", color=FAINT, markersize=8, zorder=4)
    word_at(axes, name, (float(x), float(y)))


def _solid(shape: Shape) -> Patch:
    if isinstance(shape, Box):
        corner = (shape.centre[0] - 0.5 * shape.size[0], shape.centre[1] - 0.5 * shape.size[1])
        angle = float(np.rad2deg(shape.angle))
        return Rectangle(corner, *shape.size, angle=angle, rotation_point="center", **_WALL)
    return Circle(shape.centre, shape.radius, **_WALL)


def _goal(task: NavigationTask, path: ArcPath | None, width: float | None) -> list[Patch]:
    goal = task.goal.region
    if path is not None and width is not None:
        return [_stretch(path, goal.intervals["s"], width)] if "s" in goal.intervals else []
    if goal.disc is not None:
        return [Circle(goal.disc.centre, goal.disc.radius, **_GOAL)]
    sides = [goal.intervals[name] for name in ("x", "y", "z") if name in goal.intervals]
    return (
        [Rectangle((sides[0].low, sides[1].low), *(side.length for side in sides), **_GOAL)] if len(sides) == 2 else []
    )


def _stretch(path: ArcPath, along: Interval, width: float) -> Polygon:
    """Return the part of a corridor between two arc lengths."""
    x, y, heading = path.pose(np.linspace(along.low, along.high, 30)).T
    sides = [np.column_stack((x - e * np.sin(heading), y + e * np.cos(heading))) for e in (0.5 * width, -0.5 * width)]
    return Polygon(np.vstack((sides[0], sides[1][::-1])), **_GOAL)


def _centre(patch: Patch) -> tuple[float, float]:
    """Return the centre of a patch's outline in axes units."""
    points = patch.get_patch_transform().transform(patch.get_path().vertices)
    low, high = points.min(axis=0), points.max(axis=0)
    return float(0.5 * (low[0] + high[0])), float(0.5 * (low[1] + high[1]))

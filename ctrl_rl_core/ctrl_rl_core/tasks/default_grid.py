"""Default time-to-reach grid for tasks without a grid."""

from __future__ import annotations

from ctrl_rl_core.tasks.schema.optimal_control import GridSpec
from ctrl_rl_core.tasks.task import NavigationTask

_CELL = 0.1
"""Node spacing [m]."""
_HEADINGS = 72


def with_grid(task: NavigationTask) -> NavigationTask:
    """Return a task with its own grid, or a default one for arenas and maps with states x, y, theta."""
    if task.grid or task.corridor is not None or task.system.build().state_names != ("x", "y", "theta"):
        return task
    grid = {
        name: GridSpec(interval=f"{side.low} .. {side.high} m", count=round(side.length / _CELL) + 1)
        for name, side in task.plane_bounds.items()
    }
    theta = GridSpec(interval="-180.0 .. 180.0 deg", count=_HEADINGS)
    return task.model_copy(update={"grid": grid | {"theta": theta}})

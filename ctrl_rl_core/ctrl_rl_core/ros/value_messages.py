"""Value functions as messages: a grid, a slice of it, and answers to queries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Protocol

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid
from numpy.typing import ArrayLike, NDArray
from std_msgs.msg import Header

from ctrl_rl_core.ros.node import float32_array
from ctrl_rl_core.values.plane import plane_of
from ctrl_rl_core.values.value_function import ValueFunction, batches
from ctrl_rl_core.values.value_grid import ValueGrid
from ctrl_rl_msgs.msg import GridAxis
from ctrl_rl_msgs.msg import ValueGrid as ValueGridMsg
from ctrl_rl_msgs.srv import QueryValues

_UNKNOWN, _HIGHEST = -1, 100


def grid_message(grid: ValueGrid, stamp: Time, frame: str) -> ValueGridMsg:
    """Convert a grid to a message."""
    out = ValueGridMsg(
        header=Header(stamp=stamp, frame_id=frame),
        kind=grid.kind,
        unit=grid.unit,
        task=grid.task,
        task_digest=grid.task_digest,
        grid_digest=grid.digest,
        solver=grid.solver,
        residual=float(grid.residual),
        axes=[GridAxis(**asdict(axis)) for axis in grid.axes],
    )
    out.values = float32_array(grid.values)
    return out


def slice_message(function: ValueFunction, at: Mapping[str, float], stamp: Time, frame: str) -> OccupancyGrid:
    """Convert the values over the plane of positions to a map: 0 the minimum, 100 the maximum, -1 unreachable.

    Args:
        function: Value function over positions x, y or x, z and other components.
        at: Values of the other components [their unit]; 0 by default.
        stamp: Time stamp of the message.
        frame: Frame of the positions; maps lie in x-y, so an x-z plane is shown horizontally.

    Raises:
        ValueFunctionError: There is no plane of positions, or `at` names an unknown state.
    """
    plane = plane_of(function)
    first, second = plane.first, plane.second
    resolution = min(first.spacing, second.spacing)
    columns, rows = (int(np.floor((axis.upper - axis.lower) / resolution)) + 1 for axis in (first, second))
    right = np.minimum(first.lower + resolution * np.arange(columns), first.upper)
    up = np.minimum(second.lower + resolution * np.arange(rows), second.upper)
    states = plane.states(right, up, at)
    out = OccupancyGrid(header=Header(stamp=stamp, frame_id=frame))
    out.info.map_load_time = stamp
    out.info.resolution, out.info.width, out.info.height = float(resolution), columns, rows
    # A cell is drawn around the point of its value.
    out.info.origin.position.x = first.lower - 0.5 * resolution
    out.info.origin.position.y = second.lower - 0.5 * resolution
    out.info.origin.orientation.w = 1.0
    out.data = as_percent(function.value(states)).ravel().tolist()
    return out


def as_percent(values: NDArray[np.floating]) -> NDArray[np.int8]:
    """Scale the finite values (...) to 0 .. 100; others become -1."""
    finite = np.isfinite(values)
    out = np.full(values.shape, _UNKNOWN, dtype=np.int8)
    if finite.any():
        low, high = values[finite].min(), values[finite].max()
        out[finite] = np.round(_HIGHEST * (values[finite] - low) / max(high - low, 1e-12)).astype(np.int8)
    return out


class _Answers(Protocol):
    """Protocol of a value function that can answer queries."""

    @property
    def state_names(self) -> tuple[str, ...]: ...

    def value_and_gradient(self, states: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...


def answer(function: _Answers, request: QueryValues.Request, response: QueryValues.Response) -> None:
    """Fill in the answer to a query; the additional memory does not grow with the query's size."""
    n = len(function.state_names)
    states = np.asarray(request.states, dtype=float)
    if len(states) % n:
        response.success = False
        response.message = f"{len(states)} numbers are not a multiple of {n}: {', '.join(function.state_names)}"
        return
    states = states.reshape(-1, n)
    for part in batches(len(states)):
        values, gradients = function.value_and_gradient(states[part])
        response.values.frombytes(values.tobytes())
        response.gradients.frombytes(gradients.tobytes())
        response.in_domain.extend((~np.isnan(values)).tolist())
    response.success = True

"""A time-to-reach problem (thesis Eq. 2.17-2.20): a system on a grid, a target, and obstacles.

    problem = problem_from_task("car_ttr")
    problem = TimeToReachProblem(system, axes, target=Region({"x": Interval(-0.1, 0.1)}))

Between the nodes the target is exact: it is kept as intervals and a disc, not as marked nodes. Obstacles are kept as
the clearance at the nodes and interpolated between them. What leaves the grid on an axis that is not periodic has
failed.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.geometry.units import parse_interval
from ctrl_rl_core.io import checked_json
from ctrl_rl_core.tasks.schema.system import STATE_UNITS
from ctrl_rl_core.tasks.schema.world import CorridorSpec
from numpy.typing import NDArray

from ctrl_rl_core import (
    Axis,
    Interval,
    NavigationTask,
    Region,
    System,
    World,
    load_navigation_task,
    position_indices,
    task_digest,
)
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.dependence import check_game
from ttr_reward_node.problems.obstacles import make_clearance
from ttr_reward_node.problems.problem_checks import check_axes, check_clearance, check_system, check_target

_STRAIGHT = 1e-9


@dataclass(frozen=True, eq=False)
class Clearance:
    """Distance to the nearest obstacle at the nodes of some of the axes.

    Attributes:
        axes: indices of those axes, ascending; at most two.
        values: shape (count of the first of them, ...) [m], negative inside an obstacle.
    """

    axes: tuple[int, ...]
    values: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class TimeToReachProblem:
    """Find phi(x), the shortest time from x to the target.

    Attributes:
        system: x' = f(x, u, d); u shortens the time, d prolongs it.
        axes: one for each state of the system, in its order.
        target: Gamma of Eq. 2.17; state components that it does not bound are free.
        clearance: Distance to the obstacles at the nodes; None for no obstacles.
        control_counts: samples of each control between its bounds. Two are enough for the Hamiltonian of a system that
            is affine in u; the third, the middle, saves switching to and fro between the bounds.
        name: Name of the task, for the value file.
        digest: SHA-256 of the task; empty where there is no task file, and `content_digest` then stands for it.
        inflation: Distance by which the clearance has been reduced [m], for the record.
        corridor_width: Width of the task's corridor [m], for the record; None without a corridor.

    Raises:
        TimeToReachError: anything that contradicts the above.
    """

    system: System
    axes: tuple[Axis, ...]
    target: Region
    clearance: Clearance | None = None
    control_counts: int | tuple[int, ...] = 3
    name: str = "custom"
    digest: str = field(default="")
    inflation: float = 0.0
    corridor_width: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", tuple(self.axes))
        check_axes(self.system, self.axes)
        check_system(self.system)
        check_game(self.system)
        check_target(self.target, self.axes)
        if self.clearance is not None:
            check_clearance(self.clearance.axes, self.clearance.values, self.axes)
        for what, number in (("inflation", self.inflation), ("corridor_width", self.corridor_width)):
            if number is not None and not (math.isfinite(number) and number >= 0.0):
                raise TimeToReachError(f"{what} is {number:g} m: it must be 0 or more")
        if self.digest and not re.fullmatch("[0-9a-f]{64}", self.digest):
            raise TimeToReachError(
                f"the digest is '{self.digest[:80]}': give a SHA-256, 64 hexadecimal digits, or none"
            )

    @cached_property
    def content_digest(self) -> str:
        """SHA-256 of the task; without one that of system, axes, target and, where there is one, clearance."""
        return self.digest or self._own_digest()

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Number of nodes on each axis."""
        return tuple(axis.count for axis in self.axes)

    @cached_property
    def points(self) -> int:
        """Number of nodes."""
        return math.prod(self.counts)

    def along(self, axis: int, values: NDArray[Any]) -> NDArray[Any]:
        """Values (count,) at the nodes of one axis, shaped to broadcast over the grid."""
        shape = [1] * len(self.axes)
        shape[axis] = -1
        return values.reshape(shape)

    def in_target(self) -> NDArray[np.bool_]:
        """Whether each node lies in the target, shape of the grid."""
        names = self.system.state_names
        inside = np.ones((1,) * len(names), dtype=bool)
        for k, axis in enumerate(self.axes):
            if axis.name in self.target.intervals:
                only = Region({axis.name: self.target.intervals[axis.name]})
                inside = inside & self.along(k, only.contains([axis.name], axis.nodes[:, None]))
        if self.target.disc is not None:
            i, j = position_indices(names)
            first, second = (self.along(k, self.axes[k].nodes) for k in (i, j))
            points = np.stack(np.broadcast_arrays(first, second), axis=-1)
            inside = inside & (self.target.disc.signed_distance(points) <= 0.0)
        return np.broadcast_to(inside, self.counts)

    def blocked(self) -> NDArray[np.bool_]:
        """Whether each node lies in an obstacle, shape of the grid."""
        if self.clearance is None:
            return np.broadcast_to(np.False_, self.counts)
        return np.broadcast_to(self.spread(self.clearance.values) <= 0.0, self.counts)

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values on the axes of the clearance, shaped to broadcast over the grid."""
        assert self.clearance is not None
        return values.reshape([axis.count if k in self.clearance.axes else 1 for k, axis in enumerate(self.axes)])

    def obstacle_notes(self) -> dict[str, str]:
        """Return a value file's notes on walls and obstacles [m]."""
        notes = {"obstacles": "no" if self.clearance is None else "yes", "inflation": repr(float(self.inflation))}
        if self.corridor_width is not None:
            notes["corridor_width"] = repr(float(self.corridor_width))
        return notes

    def _own_digest(self) -> str:
        system = self.system
        content = {
            "system": [system.name, dict(system.parameters), system.control_bounds.tolist()],
            "disturbances": system.disturbance_bounds.tolist(),
            "axes": [asdict(axis) for axis in self.axes],
            "target": [dict(self.target.intervals), None if self.target.disc is None else asdict(self.target.disc)],
        }
        if self.clearance is not None:  # without one the digest is that of earlier versions
            values = np.ascontiguousarray(self.clearance.values, dtype="<f4")
            content["clearance"] = [list(self.clearance.axes), hashlib.sha256(values.tobytes()).hexdigest()]
        return checked_json.digest(content)


def problem_from_task(
    task: NavigationTask | str | Path,
    *,
    counts: Sequence[int] | Mapping[str, int] | None = None,
    inflation: float = 0.0,
    width: float | None = None,
    disturbances: Mapping[str, Sequence[float]] | None = None,
    control_counts: int | tuple[int, ...] = 3,
) -> TimeToReachProblem:
    """Make the problem that a navigation task describes.

    Args:
        task: Navigation task with a `grid`, its name or its file.
        counts: Number of nodes by state name, or one for each state, in place of the task's.
        inflation: Distance by which walls and obstacles are widened [m], such as the robot's radius; 0 for a point
            robot. Walls thinner than a cell need it.
        width: Width of the task's corridor [m]; None for the task's own.
        disturbances: Bounds by name ("d_" and the state's name); no disturbance unless given.
        control_counts: Number of samples of each control that the solver tries, one for all or one for each.

    Raises:
        TimeToReachError: the task has no grid, or its corridor's goal is not a box along the axes; unknown states in
            `counts`; an inflation that is negative or not a number; walls or obstacles thinner than a cell.
        TaskError, SystemModelError: the task or the disturbance is wrong.
    """
    if not isinstance(task, NavigationTask):
        task = load_navigation_task(task)
    if not (math.isfinite(inflation) and inflation >= 0.0):
        raise TimeToReachError(f"inflation {inflation:g} m: it must be 0 or more")
    if not task.grid:
        raise TimeToReachError(f"task '{task.name}' has no value grid: add 'grid' with an axis for each state")
    system = task.system.build()
    if disturbances:
        system = with_disturbances(system, disturbances)
    axes = _axes(task, system, counts)
    world = task.build_world(width)
    return TimeToReachProblem(
        system=system,
        axes=axes,
        target=task.goal.region if task.corridor is None else _corridor_goal(task, task.corridor, width),
        clearance=_clearance(task, axes, world, inflation),
        control_counts=control_counts,
        name=task.name,
        digest=task_digest(task),
        inflation=inflation,
        corridor_width=world.width,
    )


def _clearance(task: NavigationTask, axes: tuple[Axis, ...], world: World, inflation: float) -> Clearance | None:
    """Return the clearance of a task's walls and obstacles; None for a system without positions."""
    names = [axis.name for axis in axes]
    plane = tuple(position_indices(names))
    walls = "xy" if task.arena is None or task.arena.z is None else "xz"
    if not plane and not world.obstacles:
        return None
    if [names[k] for k in plane] != list(walls):
        own = ", ".join(names[k] for k in plane) or "none"
        raise TimeToReachError(
            f"task '{task.name}': walls and obstacles lie in {walls[0]} and {walls[1]}; the positions of "
            f"{task.system.model} are {own}"
        )
    arena = None if task.arena is None else task.arena.bounds
    shapes = world.obstacles if arena is not None else (*world.walls, *world.obstacles)
    return Clearance(plane, make_clearance(shapes, arena, [axes[k] for k in plane], inflation))


def with_disturbances(system: System, bounds: Mapping[str, Sequence[float]]) -> System:
    """Return the system with disturbance bounds by name ("d_" and the state's name).

    Raises:
        TimeToReachError: an unknown name, or a lower bound above the upper one.
    """
    known = {disturbance.name for disturbance in system.disturbances}
    for name, (lower, upper) in bounds.items():
        if name not in known or not lower <= upper:
            raise TimeToReachError(
                f"disturbance '{name}' in [{lower:g}, {upper:g}]: choose from {sorted(known)}, lower <= upper"
            )
    changed = tuple(
        replace(d, lower=float(bounds[d.name][0]), upper=float(bounds[d.name][1])) if d.name in bounds else d
        for d in system.disturbances
    )
    return replace(system, disturbances=changed)


def _corridor_goal(task: NavigationTask, corridor: CorridorSpec, width: float | None) -> Region:
    """Return the goal of a corridor, given along its path, as a box of positions."""
    goal, path = task.goal.intervals, corridor.path
    along = goal.get("s", Interval(0.0, path.length))
    (x, y, heading), (_, _, end) = path.pose((along.low, along.high))
    if abs(end - heading) > _STRAIGHT or abs(np.sin(2.0 * heading)) > _STRAIGHT:
        raise TimeToReachError(
            f"task '{task.name}': its goal lies on a turn or askew; it must be on a straight piece along x or y"
        )
    half = 0.5 * (corridor.width if width is None else width)
    aside = goal.get("lateral", Interval(-half, half))
    s, lateral = np.meshgrid((0.0, along.length), aside)
    xs, ys = x + s * np.cos(heading) - lateral * np.sin(heading), y + s * np.sin(heading) + lateral * np.cos(heading)
    intervals = {"x": Interval(xs.min(), xs.max()), "y": Interval(ys.min(), ys.max())}
    if "heading" in goal:
        intervals["theta"] = Interval(heading + goal["heading"].low, heading + goal["heading"].high)
    return Region(intervals)


def _axes(task: NavigationTask, system: System, counts: Sequence[int] | Mapping[str, int] | None) -> tuple[Axis, ...]:
    names = system.state_names
    if set(task.grid) != set(names):
        raise TimeToReachError(f"task '{task.name}': grid has {sorted(task.grid)}; the states are {', '.join(names)}")
    if counts is None:
        counts = {}
    elif not isinstance(counts, Mapping):
        if len(counts) != len(names):
            raise TimeToReachError(f"{len(counts)} counts are given; the states are {', '.join(names)}")
        counts = dict(zip(names, counts, strict=True))
    unknown = set(counts) - set(names)
    if unknown:
        raise TimeToReachError(f"counts for '{min(unknown)}'; the states are {', '.join(names)}")
    axes = []
    for state in system.states:
        spec = task.grid[state.name]
        interval = parse_interval(spec.interval, STATE_UNITS[state.name])
        count = counts.get(state.name, spec.count)
        axes.append(Axis(state.name, state.unit, interval.low, interval.high, count, state.periodic))
    return tuple(axes)

"""Time-to-reach problem of a navigation task.

problem = problem_from_task("car_ttr")
"""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from ctrl_rl_core.geometry import parse_interval
from ctrl_rl_core.tasks import STATE_UNITS, CorridorSpec

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
from ttr_reward_node.problems.control_choice import choose_control_counts
from ttr_reward_node.problems.obstacles import make_clearance
from ttr_reward_node.problems.problem import Clearance, TimeToReachProblem
from ttr_reward_node.problems.velocity_hulls import VelocityHulls

_STRAIGHT = 1e-9


def problem_from_task(
    task: NavigationTask | str | Path,
    *,
    counts: Sequence[int] | Mapping[str, int] | None = None,
    inflation: float = 0.0,
    width: float | None = None,
    disturbances: Mapping[str, Sequence[float]] | None = None,
    control_counts: int | tuple[int, ...] | Mapping[str, int] | None = None,
) -> TimeToReachProblem:
    """Create the time-to-reach problem of a navigation task.

    Args:
        task: Navigation task with a `grid`, its name or its file.
        counts: Number of nodes by state name, or one for each state; default: the task's.
        inflation: Distance by which walls and obstacles are inflated [m], e.g. the robot's radius; 0 for a point robot.
            Walls thinner than a cell require it.
        width: Width of the task's corridor [m]; None for the task's own.
        disturbances: Bounds by name ("d_" and the state's name); none by default.
        control_counts: Number of samples of each control that the solver tries: one for all, one for each, or by
            control name. None and controls not named are chosen automatically.

    Raises:
        TimeToReachError: The task has no grid, or its corridor's goal is not a box along the axes; unknown states in
            `counts`; an inflation that is negative or not a number; walls or obstacles thinner than a cell.
        TaskError, SystemModelError: The task or the disturbance is invalid.
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
    if isinstance(control_counts, Mapping):
        control_counts = choose_control_counts(VelocityHulls(system, axes), control_counts) if control_counts else None
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
    """Return the clearance from a task's walls and obstacles; None for a system without positions."""
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
        TimeToReachError: An unknown name, or a lower bound above the upper one.
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


def disturbances_from_notes(notes: Mapping[str, str]) -> dict[str, tuple[float, float]]:
    """Return the disturbance bounds of a value file by name.

    Raises:
        TimeToReachError: The note was not written by `solve`.
    """
    text = notes.get("disturbances", "{}")
    try:
        given = ast.literal_eval(text)
        bounds = {str(name): (float(low), float(high)) for name, (low, high) in given.items()}
    except (ValueError, SyntaxError, TypeError, AttributeError, MemoryError, RecursionError):
        raise TimeToReachError(
            f"the value's note on disturbances is {text[:80]!r}: solve the task again, which writes a new file"
        ) from None
    return bounds


def _corridor_goal(task: NavigationTask, corridor: CorridorSpec, width: float | None) -> Region:
    """Return the goal of a corridor, specified along its path, as a box of positions."""
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

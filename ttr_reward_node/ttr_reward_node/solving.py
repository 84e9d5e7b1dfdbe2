"""Time to reach of a task or a user-defined system in one call: the function `ctrl_rl.solve`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ctrl_rl_core import (
    Axis,
    Interval,
    NavigationTask,
    OccupancyMap,
    Quantity,
    Region,
    Shape,
    System,
    ValueGrid,
    load_navigation_task,
    make_system,
    position_indices,
)
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.from_task import problem_from_task
from ttr_reward_node.problems.obstacles import make_clearance
from ttr_reward_node.problems.problem import Clearance, TimeToReachProblem
from ttr_reward_node.solvers.decomposition import find_decomposition, solve_decomposed
from ttr_reward_node.solvers.solver import check_reached, solve
from ttr_reward_node.values.decomposed_value import DecomposedValue

Axes = Sequence[Axis] | Mapping[str, tuple[float, float, int] | int]
Target = Region | Mapping[str, tuple[float, float]]
Obstacles = OccupancyMap | Sequence[Shape]


def solve_value(
    problem: NavigationTask | System | str | Path,
    axes: Axes | None = None,
    target: Target | None = None,
    *,
    obstacles: Obstacles = (),
    inflation: float | None = None,
    counts: Sequence[int] | Mapping[str, int] | None = None,
    decomposition: str | None = None,
    method: str = "semi_lagrangian",
    device: str = "cpu",
) -> ValueGrid | DecomposedValue:
    """Compute the time to reach of a task, or of a system on a grid.

    Each check that contradicts the solution issues a `DoubtfulValueWarning`. The value's method `save` writes a file
    that nodes and `load_value` read.

    >>> import ctrl_rl
    >>> value = ctrl_rl.solve("car_ttr", counts=(41, 41, 24))               # a task of the suite, coarsely
    >>> 5.0 < float(value.value([[-4.0, -3.0, 1.0]])[0]) < 20.0             # seconds from there to its goal
    True
    >>> value = ctrl_rl.solve(                                              # a system of one's own
    ...     "dubins_car",
    ...     axes={"x": (-2.0, 2.0, 41), "y": (-2.0, 2.0, 41), "theta": 24},
    ...     target={"x": (1.0, 1.4), "y": (-0.2, 0.2)},
    ...     obstacles=[ctrl_rl.Box((0.0, 0.0), (0.4, 1.6))],
    ... )

    Args:
        problem: Navigation task, its name or its file; or, with `axes` and `target`, a system or its name.
        axes: Grid of the system by state name: (lower, upper, count), or only the count for a state with its own
            bounds, e.g. an angle; or one axis for each state.
        target: Goal: (lower, upper) by state name, other states are free; or a region.
        obstacles: Obstacles of the system in the plane of its positions: shapes, or a map with occupied cells.
        inflation: Distance by which walls and obstacles are inflated [m], e.g. the robot's radius; default: the radius
            of the task's body, 0 for a system.
        counts: Number of nodes by state name, or one for each state; default: the task's.
        decomposition: Name of a decomposition of the system, e.g. "4d+4d" for the planar quadrotor: needs less memory,
            and gives a lower bound of the time. Default: the whole system is solved.
        method: "semi_lagrangian", or the thesis's "lax_friedrichs".
        device: "cpu", or "cuda" to solve on a GPU, which needs NVIDIA Warp.

    Raises:
        CtrlRlError: The task, the system or the grid is invalid, does not fit into memory, or no state outside the goal
            can reach it; the message states the remedy.
    """
    if axes is None or target is None:
        posed = _from_task(problem, axes, target, obstacles, inflation, counts)
    else:
        posed = _from_system(problem, axes, target, obstacles, 0.0 if inflation is None else inflation)
    value: ValueGrid | DecomposedValue
    if decomposition is None:
        value = solve(posed, method, device=device).grid
    else:
        value = solve_decomposed(posed, find_decomposition(posed.system, decomposition), method, device=device)
    check_reached(posed, value)
    return value


def _from_task(
    task: NavigationTask | System | str | Path,
    axes: Axes | None,
    target: Target | None,
    obstacles: Obstacles,
    inflation: float | None,
    counts: Sequence[int] | Mapping[str, int] | None,
) -> TimeToReachProblem:
    if isinstance(task, System) or axes is not None or target is not None:
        raise TimeToReachError("a system needs both axes and target; a task has its own, and needs neither")
    if isinstance(obstacles, OccupancyMap) or len(obstacles):
        raise TimeToReachError("a task has its own obstacles: write them into its file, or solve its system")
    if not isinstance(task, NavigationTask):
        task = load_navigation_task(task)
    return problem_from_task(task, counts=counts, inflation=task.robot.radius if inflation is None else inflation)


def _from_system(
    system: NavigationTask | System | str | Path, axes: Axes, target: Target, obstacles: Obstacles, inflation: float
) -> TimeToReachProblem:
    if isinstance(system, str):
        system = make_system(system)
    if not isinstance(system, System):
        raise TimeToReachError("axes and target are for a system, or the name of one; a task has its own")
    grid = _axes(system, axes)
    if not isinstance(target, Region):
        target = Region({name: Interval(float(low), float(high)) for name, (low, high) in target.items()})
    shapes = obstacles.boxes() if isinstance(obstacles, OccupancyMap) else tuple(obstacles)
    clearance = None
    if shapes:
        plane = tuple(position_indices(system.state_names))
        if len(plane) != 2:
            raise TimeToReachError(f"obstacles need two positions; the states are {', '.join(system.state_names)}")
        clearance = Clearance(plane, make_clearance(shapes, None, [grid[index] for index in plane], inflation))
    return TimeToReachProblem(system, grid, target, clearance, name=system.name, inflation=inflation)


def _axes(system: System, axes: Axes) -> tuple[Axis, ...]:
    if not isinstance(axes, Mapping):
        return tuple(axes)
    if set(axes) != set(system.state_names):
        raise TimeToReachError(f"axes are {', '.join(axes)}; the states are {', '.join(system.state_names)}")
    return tuple(_axis(state, axes[state.name]) for state in system.states)


def _axis(state: Quantity, given: tuple[float, float, int] | int) -> Axis:
    low, high, count = (state.lower, state.upper, given) if isinstance(given, int) else given
    return Axis(state.name, state.unit, float(low), float(high), int(count), state.periodic)

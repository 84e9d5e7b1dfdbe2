"""Time to reach of a large system from those of small subsystems (thesis section 3.2.2; Mo Chen et al. 2016).

    value = solve_decomposed("quad_ttr", PLANAR_QUADROTOR_4D)
    value.value(states), value.free                 # same interface as ValueGrid; free states and controls

A subsystem keeps some of the states. Any other state in its dynamics becomes an additional control, bounded by that
state's grid axis; and each subsystem chooses shared controls independently. Each subsystem thus has more freedom than
the whole, and its target and obstacles are projections of the whole's. So every sub-value, and their maximum, is a
lower bound of the true time to reach; `verification.decomposition_error` measures the gap.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.systems import Dynamics, Equations
from numpy.typing import NDArray

from ctrl_rl_core import Disc, Interval, NavigationTask, Quantity, Region, System, position_indices
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.dependence import dependences, is_affine
from ttr_reward_node.problems.from_task import problem_from_task
from ttr_reward_node.problems.problem import Clearance, TimeToReachProblem
from ttr_reward_node.solvers.solution import Progress, Solution
from ttr_reward_node.solvers.solver import solve
from ttr_reward_node.values.decomposed_value import DecomposedValue


@dataclass(frozen=True)
class Decomposition:
    """Names of the states kept by each subsystem; subsystems may share states."""

    name: str
    subsystems: tuple[tuple[str, ...], ...]


PLANAR_QUADROTOR_4D = Decomposition("4d+4d", (("x", "v_x", "psi", "omega"), ("z", "v_z", "psi", "omega")))
"""Decomposition of the thesis: both halves contain pitch and pitch rate."""

PLANAR_QUADROTOR_FIVE = Decomposition("five", (("x",), ("z",), ("omega",), ("v_x", "psi"), ("v_z", "psi")))
"""Decomposition of the published code."""

DECOMPOSITIONS = {
    "planar_quadrotor": {d.name: d for d in (PLANAR_QUADROTOR_4D, PLANAR_QUADROTOR_FIVE)},
}


@dataclass(frozen=True, eq=False)
class Subsystem:
    """Part of a problem.

    Attributes:
        problem: Problem over the kept states.
        free: States and controls that the subsystem chooses freely although the whole system does not: states in its
            dynamics that it does not keep, and controls shared with another subsystem.
    """

    problem: TimeToReachProblem
    free: tuple[str, ...]


def find_decomposition(system: System, name: str) -> Decomposition:
    """Return a decomposition of a system by its name.

    Raises:
        TimeToReachError: The system has no decomposition of that name.
    """
    known = DECOMPOSITIONS.get(system.name, {})
    if name not in known:
        there = f"there are {', '.join(known)}" if known else "there is none: leave the decomposition out"
        raise TimeToReachError(f"{system.name} has no decomposition '{name}'; {there}")
    return known[name]


def split(problem: TimeToReachProblem, decomposition: Decomposition) -> tuple[Subsystem, ...]:
    """Split a problem into subsystems.

    Raises:
        TimeToReachError: An unknown state, a state that no subsystem keeps, or a disturbance.
    """
    names = problem.system.state_names
    kept = [name for states in decomposition.subsystems for name in states]
    if set(kept) != set(names):
        wrong = set(kept) ^ set(names)
        raise TimeToReachError(f"decomposition '{decomposition.name}': '{min(wrong)}' is unknown or in no subsystem")
    if (problem.system.disturbance_bounds[0] < problem.system.disturbance_bounds[1]).any():
        raise TimeToReachError("under a disturbance a decomposition gives no lower bound: solve the system as a whole")
    needs = _dependence_names(problem)
    controls = problem.system.control_names
    wanted = [{name for state in states for name in needs[names.index(state)]} for states in decomposition.subsystems]
    subsystems = []
    for i, states in enumerate(decomposition.subsystems):
        ordered = tuple(name for name in names if name in states)
        borrowed = tuple(name for name in names if name in wanted[i] and name not in states)
        used = tuple(name for name in controls if name in wanted[i])
        shared = tuple(name for name in used if any(name in other for j, other in enumerate(wanted) if j != i))
        subsystems.append(Subsystem(_make_subproblem(problem, ordered, borrowed, used), borrowed + shared))
    return tuple(subsystems)


def solve_decomposed(
    problem: TimeToReachProblem | NavigationTask | str | Path,
    decomposition: Decomposition,
    method: str = "semi_lagrangian",
    *,
    counts: Sequence[int] | Mapping[str, int] | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
) -> DecomposedValue:
    """Solve each subsystem; the maximum of the solutions is a lower bound of the time to reach.

    Args:
        problem: Problem, or a navigation task, its name or its file.
        decomposition: States kept by each subsystem.
        method: Name of the solver, one of `solver.METHODS`.
        counts: Number of nodes by state name, or one for each state; default: the task's.
        progress: Function called after each sweep with its number and the largest change [s].
        device: Device on which each subsystem is solved, as for `solve`.

    Raises:
        TimeToReachError: The decomposition does not fit the problem, or `solve` rejects a subsystem.
    """
    parts = solve_parts(problem, decomposition, method, counts=counts, progress=progress, device=device)
    return join(decomposition, *parts)


def solve_parts(
    problem: TimeToReachProblem | NavigationTask | str | Path,
    decomposition: Decomposition,
    method: str = "semi_lagrangian",
    *,
    counts: Sequence[int] | Mapping[str, int] | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
) -> tuple[TimeToReachProblem, tuple[Subsystem, ...], tuple[Solution, ...]]:
    """Solve each subsystem as `solve_decomposed` does; return the problem, its subsystems and their solutions."""
    if not isinstance(problem, TimeToReachProblem):
        problem = problem_from_task(problem, counts=counts)
    subsystems = split(problem, decomposition)
    return (
        problem,
        subsystems,
        tuple(solve(part.problem, method, progress=progress, device=device) for part in subsystems),
    )


def join(
    decomposition: Decomposition,
    problem: TimeToReachProblem,
    subsystems: Sequence[Subsystem],
    solutions: Sequence[Solution],
) -> DecomposedValue:
    """Return the maximum of the subsystems' solutions as one value function."""
    return DecomposedValue(
        grids=tuple(solution.grid for solution in solutions),
        axes=problem.axes,
        name=decomposition.name,
        free=tuple(part.free for part in subsystems),
    )


def _dependence_names(problem: TimeToReachProblem) -> list[set[str]]:
    """Return, for each state, the states and controls in its derivative, including constant controls."""
    system = problem.system
    return [
        {system.state_names[k] for k in rate.states} | {system.control_names[k] for k in rate.controls}
        for rate in dependences(system, hold=False)
    ]


def _make_subproblem(
    problem: TimeToReachProblem, states: tuple[str, ...], borrowed: tuple[str, ...], used: tuple[str, ...]
) -> TimeToReachProblem:
    """Return the problem over the kept states, with borrowed states as controls."""
    whole, names = problem.system, problem.system.state_names
    kept = [names.index(name) for name in states]
    lent = [
        Quantity(axis.name, axis.unit, max(low, axis.lower), min(high, axis.upper))
        for axis, low, high in zip(problem.axes, *problem.limits, strict=True)
        if axis.name in borrowed
    ]
    own = [control for control in whole.controls if control.name in used]
    sources: list[tuple[int, int]] = []
    for name in names:
        if name in states:
            sources.append((0, states.index(name)))
        else:
            sources.append((1, borrowed.index(name)) if name in borrowed else (2, 0))
    sources.extend((1, len(lent) + used.index(name)) if name in used else (2, 0) for name in whole.control_names)
    nominal = tuple(whole.nominal_disturbance.tolist())
    system = System(
        name=f"{whole.name}[{','.join(states)}]",
        states=tuple(whole.states[k] for k in kept),
        controls=tuple(lent + own),
        disturbances=tuple(whole.disturbances[k] for k in kept),
        parameters=whole.parameters,
        equations=_sub_equations(whole.equations, tuple(sources), tuple(kept), nominal),
    )
    counts = problem.control_counts  # not valid for borrowed states, which may be angles
    return replace(
        problem,
        system=system,
        axes=tuple(problem.axes[k] for k in kept),
        target=_project_target(problem.target, names, states),
        clearance=_project_clearance(problem.clearance, kept),
        control_counts=counts if isinstance(counts, int) and is_affine(system) else None,
        more_controls=(),
    )


@lru_cache(maxsize=32)
def _sub_equations(
    whole: Equations, sources: tuple[tuple[int, int], ...], kept: tuple[int, ...], nominal: tuple[float, ...]
) -> Equations:
    """Return the equations of the whole system restricted to some states.

    Args:
        whole: Equations of the whole system.
        sources: Source of each state and control of the whole: kind (0 kept state, 1 control, 2 zero) and index.
        kept: Indices of the kept states.
        nominal: Disturbance of the whole, for the states not kept.
    """
    states = len(nominal)

    def equations(math: Any, parameters: Mapping[str, float]) -> Dynamics:
        f: Callable[..., Any] = whole(math, parameters)

        def part(x: Any, u: Any, d: Any) -> tuple[Any, ...]:
            from_ = (x, u)
            full = [0.0 if kind == 2 else from_[kind][index] for kind, index in sources]
            pushed = list(nominal)
            for place, k in enumerate(kept):
                pushed[k] = d[place]
            rates = f(full[:states], full[states:], pushed)
            return tuple(rates[k] for k in kept)

        return part

    return equations


def _project_target(target: Region, names: Sequence[str], states: Sequence[str]) -> Region:
    """Project the target onto the kept states: all values that the other states can complete to a target state."""
    intervals = {name: interval for name, interval in target.intervals.items() if name in states}
    disc: Disc | None = target.disc
    if disc is not None:
        plane = [names[k] for k in position_indices(names)]
        if not set(plane) <= set(states):
            for name, middle in zip(plane, disc.centre, strict=True):
                if name in states:
                    low, high = intervals.get(name, Interval(-np.inf, np.inf))
                    intervals[name] = Interval(max(low, middle - disc.radius), min(high, middle + disc.radius))
            disc = None
    return Region(intervals, disc)


def _project_clearance(clearance: Clearance | None, kept: Sequence[int]) -> Clearance | None:
    """Project the clearance onto the kept states: its maximum over the others."""
    if clearance is None:
        return None
    axes = tuple(k for k in clearance.axes if k in kept)
    if not axes:
        return None
    dropped = tuple(i for i, k in enumerate(clearance.axes) if k not in kept)
    values: NDArray[np.float32] = clearance.values.max(axis=dropped) if dropped else clearance.values
    return Clearance(tuple(list(kept).index(k) for k in axes), values)

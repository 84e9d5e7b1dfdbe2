"""The optimal control problem of a task: objective and constraints (thesis Eq. 3.11, 3.12, 3.16)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from ctrl_rl_core.tasks import OptimalControlSpec
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import (
    Disc,
    Interval,
    NavigationTask,
    Region,
    Shape,
    System,
    make_system,
    position_indices,
    signed_distance,
    task_digest,
)
from oc_baseline_node.errors import OcError
from oc_baseline_node.problems import coordinates
from oc_baseline_node.problems.coordinates import in_plane, path_car

Array = NDArray[np.float64]
Form = Literal["free_speed", "free_time", "letter"]
FORMS: tuple[Form, ...] = get_args(Form)
"""Forms that make Eq. 3.16 feasible from most starts.

`free_speed`: every control is free within its bounds. `free_time`: the speed is constant and the time step is free,
with one value per trajectory. `letter`: neither is free."""
TIME_STEP_RANGE = (0.2, 4.0)
"""Range of a free time step, as multiples of the task's."""
MODELS_OWN = "the model's own bounds, as the task names none"
"""Source of control bounds that come from the model."""
_ROOM = 0.02
"""Margin to contact and to the tilt limit if the task specifies none [m, rad]."""
_HEAVIEST = 1e100
"""Maximum weight of a squared distance [1/m^2]; sums and squares of larger ones overflow."""
_RANGES = {"planar_quadrotor": ("v_x", "v_z", "omega")}
"""State bounds that only limit grids (thesis Table 3.1); neither model nor simulators enforce them."""
_INSIDE = 1e-3
"""Distance inside the goal's bounds at which a trajectory must end, larger than a solver's tolerance [m, rad]."""


@dataclass(frozen=True)
class OptimalControlProblem:
    """min over u of sum_k gamma^(k+1) (Q |p_k - p*|^2 - W |p_k - p_trap|^2) + R |u_k|^2, k = 0 .. H - 1.

    Subject to the system, x_0 given, x_H in the terminal set, p_k at least d_min from obstacles, and states and
    controls within bounds. The W term is the trap form of section 3.3.3. In a corridor, x and p are path coordinates.

    Attributes:
        task: Task of the problem.
        system: Dynamics f with the problem's bounds of u; the task's own, or in a corridor `path_car`.
        form: Form of the problem, one of `FORMS`.
        horizon: Number H of steps.
        time_step: Duration of a step [s].
        gamma: Growth factor of the state cost per step, distinct from the discount of Eq. 3.13.
        discount: Discount per policy step, in Eq. 3.13.
        state_weight: Weight Q of the squared distance to the goal [1/m^2].
        control_weight: Weight R of the squared controls.
        trap_weight: Weight W of the squared distance to the trap [1/m^2].
        goal: Centre p* of the goal (2,) [m].
        trap: Centre of the trap (2,) [m], or None.
        terminal: Terminal set of x_H: the goal, within the task's terminal set.
        obstacles: Shapes from which positions keep d_min.
        clearance: Minimum distance d_min from obstacles [m].
        state_bounds: Minimum and maximum states (2, n); infinite if free.
    """

    task: NavigationTask
    system: System
    form: Form
    horizon: int
    time_step: float
    gamma: float
    discount: float
    state_weight: float
    control_weight: float
    trap_weight: float
    goal: tuple[float, float]
    trap: tuple[float, float] | None
    terminal: Region
    obstacles: tuple[Shape, ...]
    clearance: float
    state_bounds: Array

    @property
    def positions(self) -> list[int]:
        """Indices in x of the plane's two coordinates: x and y, x and z, or s and lateral."""
        return [0, 1] if self.task.corridor is not None else position_indices(self.system.state_names)

    @property
    def sources(self) -> tuple[str, ...]:
        """Source of each control's bounds: a part of the task file, or the model (m,)."""
        spec = self.task.optimal_control
        freed = set(spec.controls) if spec is not None and self.form == "free_speed" else set()
        return tuple(
            "optimal_control.controls"
            if name in freed
            else "system.controls"
            if name in self.task.system.controls
            else MODELS_OWN
            for name in self.system.control_names
        )

    @cached_property
    def periods(self) -> Array:
        """Period of each state (n,); inf for a non-angular state."""
        return coordinates.periods(self.system, self.positions)

    def bounds_around(self, state: Array) -> Array:
        """Return the state bounds (2, n) of trajectories from a state (n,), with angles shifted by whole periods."""
        return coordinates.bounds_around(state, self.state_bounds, self.periods)

    def ways_round(self, state: Array, bounds: Array) -> list[tuple[float, Region]]:
        """Return copies of the terminal set reachable from a state (n,) within bounds (2, n), nearest first.

        Each comes with its distance in periods.
        """
        return coordinates.ways_round(self.terminal, self.system.state_names, self.periods, state, bounds)

    def task_states(self, states: ArrayLike) -> Array:
        """Convert states (..., n) of `system` to states (..., n) of the task's own system."""
        if self.task.corridor is None:
            return np.asarray(states, dtype=float)
        return in_plane(self.task.corridor.path, states)

    @property
    def digest(self) -> str:
        """SHA-256 of the task."""
        return task_digest(self.task)

    def margin(self, states: ArrayLike) -> Array:
        """Return the margin (...) of states (..., n) to d_min and the map's edge [m]; negative if violated."""
        states = np.asarray(states, dtype=float)
        points = states[..., self.positions]
        low, high = self.state_bounds[:, self.positions]
        inside = np.minimum(points - low, high - points).min(axis=-1)
        return np.minimum(inside, signed_distance(self.obstacles, points) - self.clearance)

    def refusal(self, state: ArrayLike) -> str:
        """Explain why no trajectory can start in `state` (n,); empty if it can."""
        state = np.asarray(state, dtype=float)
        names = self.system.state_names
        if state.shape != (len(names),) or not np.isfinite(state).all():
            return f"start is not {len(names)} finite numbers ({', '.join(names)})"
        low, high = self.bounds_around(state)
        for index in np.flatnonzero((state < low - 1e-9) | (state > high + 1e-9)):
            least, most = self.state_bounds[:, index]
            return f"start: {names[index]} = {state[index]:.3g} is out of bounds, {least:.4g} .. {most:.4g}"
        margin = float(self.margin(state))
        if margin < -1e-9:
            gap = self.clearance + margin
            where = f"{gap:.3g} m from an obstacle" if gap >= 0.0 else f"{-gap:.3g} m inside an obstacle"
            return f"start: {where}, d_min is {self.clearance:g} m"
        return ""

    def terminal_violation(self, state: ArrayLike) -> float:
        """Return the distance of a state (n,) outside the terminal set [m, rad, ...]; zero or less inside."""
        state = np.asarray(state, dtype=float)
        out = coordinates.outside(self.terminal, self.system.state_names, self.periods, state)
        if self.terminal.disc is not None:
            out = max(out, float(self.terminal.disc.signed_distance(state[self.positions])))
        return out


def formulate(task: NavigationTask, form: Form = "free_speed", clearance: float | None = None) -> OptimalControlProblem:
    """Formulate the problem of a task.

    Args:
        task: Task with a part `optimal_control`; obstacles only in an arena.
        form: Form of the problem, one of `FORMS`.
        clearance: Minimum distance d_min from obstacles [m]; defaults to the task's, raised above the body's radius if
            necessary, because the body would collide.

    Raises:
        OcError: The task lacks a part of the problem, or its terminal set is empty within the bounds.
    """
    oc = task.optimal_control
    if oc is None:
        raise OcError(f"task '{task.name}' has no part 'optimal_control': add its constants to the task file")
    if form not in FORMS:
        raise OcError(f"no form '{form}': there are {', '.join(FORMS)}")
    try:
        heaviest = oc.state_weight * oc.gamma**oc.horizon
    except OverflowError:
        heaviest = np.inf
    if heaviest > _HEAVIEST:
        raise OcError(f"task '{task.name}': the state cost grows to optimal_control.gamma^horizon = {oc.gamma:g}^"
                      f"{oc.horizon}, beyond {_HEAVIEST:g}: take a gamma nearer to 1")  # fmt: skip
    d_min = max(oc.clearance, task.robot.radius + _ROOM) if clearance is None else clearance
    system = _system(task, oc, form)
    if task.map is not None:
        raise OcError(f"task '{task.name}': an optimal control problem is of an arena or a corridor, not of a map")
    if task.corridor is not None:
        if task.obstacles:
            raise OcError(f"task '{task.name}': an optimal control problem in a corridor does not support obstacles")
        system = path_car(system, task.corridor.path)
    return OptimalControlProblem(
        task=task,
        system=system,
        form=form,
        horizon=oc.horizon,
        time_step=oc.time_step,
        gamma=oc.gamma,
        discount=oc.discount,
        state_weight=oc.state_weight,
        control_weight=oc.control_weight,
        trap_weight=oc.trap_weight if task.trap is not None else 0.0,
        goal=_goal(task),
        trap=None if task.trap is None else task.trap.region.position,
        terminal=_terminal(task, oc),
        obstacles=task.build_world().obstacles,
        clearance=d_min,
        state_bounds=_state_bounds(task, oc, system, d_min),
    )


def _goal(task: NavigationTask) -> tuple[float, float]:
    region = task.goal.region
    return region.position if task.corridor is None else (region.intervals["s"].centre, 0.0)


def _system(task: NavigationTask, oc: OptimalControlSpec, form: Form) -> System:
    """Return the model with the control bounds required by the form; the task's own fix the speed of a car.

    A control missing from `optimal_control.controls` keeps the bounds of `system.controls`, or else the model's.
    """
    own = task.system.build()
    if form != "free_speed":
        return own
    unknown = set(oc.controls) - set(own.control_names)
    if unknown:
        raise OcError(f"task '{task.name}': optimal_control.controls names '{min(unknown)}', which the system lacks")
    bounds = zip(own.control_names, own.control_bounds.T.tolist(), strict=True)
    chosen = make_system(own.name, parameters=own.parameters, control_bounds={**dict(bounds), **oc.controls})
    return replace(own, controls=chosen.controls)


def _terminal(task: NavigationTask, oc: OptimalControlSpec) -> Region:
    """Return the goal ("final state in G", Eq. 3.16) intersected with the task's terminal set, slightly shrunk."""
    goal, wanted = task.goal.region, (oc.terminal_set or task.goal).region
    intervals = {}
    for name in {**goal.intervals, **wanted.intervals}:
        both = [region.intervals[name] for region in (goal, wanted) if name in region.intervals]
        low, high = max(each.low for each in both) + _INSIDE, min(each.high for each in both) - _INSIDE
        if low > high:
            raise OcError(f"task '{task.name}': goal and optimal_control.terminal_set do not meet in '{name}'")
        intervals[name] = Interval(low, high)
    discs = [region.disc for region in (goal, wanted) if region.disc is not None]
    if len(set(discs)) > 1:
        raise OcError(f"task '{task.name}': optimal_control.terminal_set has another disc than the goal; give one disc")
    return Region(intervals, Disc(discs[0].centre, discs[0].radius - _INSIDE) if discs else None)


def _state_bounds(task: NavigationTask, oc: OptimalControlSpec, system: System, clearance: float) -> Array:
    """Return the state bounds (2, n) of task and model, reduced by d_min from walls and by the tilt limit."""
    bounds = np.array([[-np.inf] * len(system.states), [np.inf] * len(system.states)])
    for name, interval in oc.bounds.items():
        if name not in system.state_names:
            raise OcError(f"task '{task.name}': optimal_control.bounds names '{name}', which the system lacks")
        bounds[:, system.state_names.index(name)] = interval
    for index, own in enumerate(system.states):
        of_task = own.name in task.system.states
        if of_task or not (own.periodic or own.name in _RANGES.get(system.name, ())):
            bounds[:, index] = max(bounds[0, index], own.lower), min(bounds[1, index], own.upper)
    for name, wall in _walls(task).items():
        index = system.state_names.index(name)
        low, high = bounds[:, index]
        bounds[:, index] = max(low, wall.low + clearance), min(high, wall.high - clearance)
    if task.robot.tilt_limit is not None and "psi" in system.state_names:
        index, limit = system.state_names.index("psi"), task.robot.tilt_limit - _ROOM
        bounds[:, index] = np.clip(bounds[:, index], -limit, limit)
    if not (bounds[0] < bounds[1]).all():
        raise OcError(
            f"task '{task.name}': no state is {clearance:g} m from the walls and within optimal_control.bounds"
        )
    return bounds


def _walls(task: NavigationTask) -> dict[str, Interval]:
    """Return the walls' coordinates by position component [m]; a corridor is open at its end."""
    if task.corridor is not None:
        half = 0.5 * task.corridor.width
        return {"s": Interval(0.0, np.inf), "lateral": Interval(-half, half)}
    assert task.arena is not None
    return dict(zip(task.plane, task.arena.bounds, strict=True))

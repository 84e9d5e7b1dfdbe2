"""Time-to-reach problem (thesis Eq. 2.17-2.20): a system on a grid, a target, and obstacles.

    problem = TimeToReachProblem(system, axes, target=Region({"x": Interval(-0.1, 0.1)}))

The target is stored exactly, as intervals and a disc, not as marked nodes. Obstacles are stored as the clearance at the
nodes and interpolated between them. A trajectory fails when it leaves the grid along a non-periodic axis, or the
state's own bounds.
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from ctrl_rl_core.io import digest
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import Axis, Interval, Region, System, position_indices
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.control_choice import (
    check_control_counts,
    choose_control_counts,
    choose_more_controls,
    control_doubt,
    sample_controls,
)
from ttr_reward_node.problems.dependence import check_game
from ttr_reward_node.problems.equation_checks import check_disturbances, check_equations
from ttr_reward_node.problems.jumps import find_jump
from ttr_reward_node.problems.limits import state_limits, tighter_limits
from ttr_reward_node.problems.problem_checks import (
    check_axes,
    check_clearance,
    check_counts,
    check_system,
    check_target,
)
from ttr_reward_node.problems.velocity_hulls import VelocityHulls

_ROUNDING = 1e-9  # fraction of an axis's length


@dataclass(frozen=True, eq=False)
class Clearance:
    """Distance to the nearest obstacle at the nodes of one or two axes.

    Attributes:
        axes: Indices of these axes, ascending; at most two.
        values: Distances (count of the first axis, ...) [m], negative inside an obstacle.
    """

    axes: tuple[int, ...]
    values: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class TimeToReachProblem:
    """Find phi(x), the shortest time from x to the target.

    Attributes:
        system: x' = f(x, u, d); u minimises the time, d maximises it.
        axes: One axis for each state of the system, in its order.
        target: Gamma of Eq. 2.17; state components without bounds are free.
        clearance: Distance to the obstacles at the nodes; None for no obstacles.
        control_counts: Samples of each control between its bounds, one number for all or one for each. None chooses a
            number, which can be read afterwards: three for a system affine in u, where two would suffice for the
            Hamiltonian and the middle avoids chattering; otherwise the result of `control_choice`.
        more_controls: Additional controls to try; chosen along with the counts.
        name: Name of the task, for the value file.
        digest: SHA-256 of the task; if empty (no task file), `content_digest` replaces it.
        inflation: Distance by which the clearance has been reduced [m], for the record.
        corridor_width: Width of the task's corridor [m], for the record; None without a corridor.

    Raises:
        TimeToReachError: An attribute is invalid or inconsistent with the others.
    """

    system: System
    axes: tuple[Axis, ...]
    target: Region
    clearance: Clearance | None = None
    control_counts: int | tuple[int, ...] | None = None
    more_controls: tuple[tuple[float, ...], ...] = ()
    name: str = "custom"
    digest: str = field(default="")
    inflation: float = 0.0
    corridor_width: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", tuple(self.axes))
        check_system(self.system)
        check_axes(self.system, self.axes)
        check_counts(self.axes, check_equations(self.system, self.axes))
        check_game(self.system)
        check_disturbances(self.system, self.axes)
        check_target(self.target, self.axes, self.limits)
        if self.control_counts is None:
            counts = choose_control_counts(self._hulls)
            more = choose_more_controls(self._hulls, counts)
            object.__setattr__(self, "control_counts", counts)
            object.__setattr__(self, "more_controls", tuple(tuple(each) for each in more.tolist()))
        else:
            check_control_counts(self.system, self.control_counts)
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
        """SHA-256 of the task; without a task, that of system, axes, target and, if present, clearance."""
        return self.digest or self._own_digest()

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Number of nodes on each axis."""
        return tuple(axis.count for axis in self.axes)

    @cached_property
    def points(self) -> int:
        """Number of nodes."""
        return math.prod(self.counts)

    @property
    def disturbances(self) -> dict[str, tuple[float, float]]:
        """Bounds by name of the disturbances that are not identically zero, including constant ones."""
        return {d.name: (d.lower, d.upper) for d in self.system.disturbances if (d.lower, d.upper) != (0.0, 0.0)}

    @cached_property
    def control_samples(self) -> NDArray[np.float64]:
        """Controls (k, m) tried by the solvers and by roll-outs."""
        assert self.control_counts is not None  # chosen in __post_init__
        even = sample_controls(self._hulls, self.control_counts)
        return np.concatenate((even, np.reshape(self.more_controls, (len(self.more_controls), even.shape[1]))))

    @cached_property
    def control_doubt(self) -> str:
        """Warning that the controls have too few samples, with a remedy; empty if they have enough."""
        assert self.control_counts is not None
        return control_doubt(self._hulls, self.control_counts, self.control_samples)

    @cached_property
    def jump(self) -> str:
        """Name of a state along which a derivative jumps, "" if none does; the solvers take short steps there."""
        return find_jump(self.system, self.axes)

    @cached_property
    def limits(self) -> NDArray[np.float64]:
        """Range (2, n) within which each state must stay: the grid's ends, tightened by the state's own bounds.

        -inf and inf along a periodic axis.
        """
        return state_limits(self.system, self.axes)

    def wrap(self, states: ArrayLike) -> NDArray[np.float64]:
        """Return a copy of states (..., n), wrapped along periodic axes to [lower, upper) of the axis.

        A periodic state on a non-periodic axis is not wrapped: it may leave the grid.
        """
        wrapped = np.array(states, dtype=np.float64)
        for k, axis in enumerate(self.axes):
            if axis.periodic:
                angle = axis.lower + np.mod(wrapped[..., k] - axis.lower, axis.upper - axis.lower)
                # The remainder of a tiny negative number rounds up to the whole period.
                wrapped[..., k] = np.where(angle >= axis.upper, axis.lower, angle)
        return wrapped

    def outside(self) -> NDArray[np.bool_]:
        """Whether each node lies outside the limits, shape of the grid; all false if the axes end within the limits."""
        beyond = np.zeros((1,) * len(self.axes), dtype=bool)
        for k, axis in enumerate(self.axes):
            low, high = self.limits[:, k]
            beyond = beyond | self.along(k, (axis.nodes < low) | (axis.nodes > high))
        return np.broadcast_to(beyond, self.counts)

    def along(self, axis: int, values: NDArray[Any]) -> NDArray[Any]:
        """Reshape values (count,) at the nodes of one axis to broadcast over the grid."""
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

    def reached(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Whether each state (..., n) lies in the target, up to rounding."""
        x = np.array(states, dtype=np.float64)
        for k, axis in enumerate(self.axes):
            if axis.periodic and axis.name in self.target.intervals:
                period, middle = axis.upper - axis.lower, self.target.intervals[axis.name].centre
                x[..., k] -= period * np.round((x[..., k] - middle) / period)
        return self._rounded_target.contains(self.system.state_names, x)

    @cached_property
    def _rounded_target(self) -> Region:
        """Target enlarged by the rounding tolerance."""
        slack = {axis.name: _ROUNDING * (axis.upper - axis.lower) for axis in self.axes}
        intervals = {
            name: Interval(low - slack[name], high + slack[name]) for name, (low, high) in self.target.intervals.items()
        }
        disc = self.target.disc
        if disc is not None:
            disc = replace(disc, radius=disc.radius * (1.0 + _ROUNDING))
        return Region(intervals, disc)

    def left(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Whether each state (..., n) lies outside the limits by more than the rounding tolerance."""
        slack = np.array([_ROUNDING * (axis.upper - axis.lower) for axis in self.axes])
        x = np.asarray(states, dtype=np.float64)
        return np.asarray(((x < self.limits[0] - slack) | (x > self.limits[1] + slack)).any(axis=-1))

    def blocked(self) -> NDArray[np.bool_]:
        """Whether each node lies in an obstacle, shape of the grid."""
        if self.clearance is None:
            return np.broadcast_to(np.False_, self.counts)
        return np.broadcast_to(self.spread(self.clearance.values) <= 0.0, self.counts)

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """Reshape values on the axes of the clearance to broadcast over the grid."""
        assert self.clearance is not None
        return values.reshape([axis.count if k in self.clearance.axes else 1 for k, axis in enumerate(self.axes)])

    def obstacle_notes(self) -> dict[str, str]:
        """Return the notes on walls and obstacles for a value file [m]."""
        notes = {"obstacles": "no" if self.clearance is None else "yes", "inflation": repr(float(self.inflation))}
        if self.corridor_width is not None:
            notes["corridor_width"] = repr(float(self.corridor_width))
        return notes

    @cached_property
    def _hulls(self) -> VelocityHulls:
        return VelocityHulls(self.system, self.axes)

    def _own_digest(self) -> str:
        system = self.system
        content = {
            "system": [system.name, dict(system.parameters), system.control_bounds.tolist()],
            "disturbances": system.disturbance_bounds.tolist(),
            "axes": [asdict(axis) for axis in self.axes],
            "target": [dict(self.target.intervals), None if self.target.disc is None else asdict(self.target.disc)],
        }
        if self.clearance is not None:  # problems without a clearance keep the digest of earlier versions
            values = np.ascontiguousarray(self.clearance.values, dtype="<f4")
            content["clearance"] = [list(self.clearance.axes), hashlib.sha256(values.tobytes()).hexdigest()]
        if limits := tighter_limits(system, self.axes):  # likewise
            content["limits"] = limits
        return digest(content)

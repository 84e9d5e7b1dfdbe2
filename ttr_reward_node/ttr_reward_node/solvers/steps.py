"""Steps of the semi-Lagrangian scheme: displacement of the system from each node under each control.

Robots move the same way at every position, so f does not depend on some of the axes. The steps are tabulated over the
other axes only (for a car, 72 headings rather than 734,472 nodes), from the single definition of f, which NumPy
evaluates; the compiled code is independent of the system.

A step lasts until the axis that moves fastest, in cells, has moved `cells` whole cells, however long that takes. So it
ends on a plane of the grid: no interpolation is needed along that axis, and a node never refers to itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, System
from ttr_reward_node.problems.dependence import dependences, is_affine
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.held_motion import Derivatives, HeldPairs

_BLOCK = 3 << 9  # number of steps computed at once, so that their arrays fit into the cache
FEW_AXES, _MANY_AXES = 2, 4
SMALL = 100_000
"""Number of nodes below which one thread is enough: each has memory of its own, as much as a quarter of the tables."""


class Gridded(Protocol):
    """Problem on a grid: a system, and an axis for each of its states."""

    @property
    def system(self) -> System:
        """Dynamics of the problem."""

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes, one for each state."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Order of the axes in memory: first those that f depends on (`outer`), then the others (`inner`).

    Attributes:
        outer, inner: Indices of the problem's axes on which f depends, and of the others.
        counts: Number of nodes on each axis, in this order.
        periodic: Whether each axis is periodic, in this order.
    """

    outer: tuple[int, ...]
    inner: tuple[int, ...]
    counts: NDArray[np.int64]
    periodic: NDArray[np.bool_]

    @property
    def order(self) -> tuple[int, ...]:
        """Indices of all axes, outer ones first."""
        return self.outer + self.inner

    def ordered(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Reorder values (..., n) of the problem's axes to this order."""
        return values if self.order == tuple(range(len(self.order))) else values[..., self.order]

    @property
    def slabs(self) -> int:
        """Number of nodes of the outer axes; f is constant along the inner ones."""
        return math.prod(self.counts[: len(self.outer)].tolist())


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of each slab under each pair of disturbance and control, axes in the layout's order.

    Attributes:
        held: Controls and disturbances of the pairs: disturbances vary slowest, then lengths, then controls.
        lengths: Length of each pair's step [cells].
        codes: Code of each step's duration (slabs, pairs); 0 if nothing moves or the step would leave the limits of an
            outer axis.
        durations: Durations by code [s]; 0 for code 0.
        ends: Displacements at the end (slabs, pairs, n) [1 / PER_CELL cells].
        ranges: Lowest and highest cell of a step's path along each inner axis (slabs, pairs, inner, 2).
        controls: Number of combinations of control and step length; the number of pairs is a multiple of it.
        crossing: Time to cross a cell along the slowest axis at its top speed [s].
    """

    held: HeldPairs
    lengths: NDArray[np.float64]
    codes: NDArray[np.uint16]
    durations: NDArray[np.float64]
    ends: NDArray[np.int16]
    ranges: NDArray[np.int8]
    controls: int
    crossing: float


def make_layout(problem: Gridded) -> Layout:
    """Determine the axes on which f depends."""
    depends = frozenset[int]().union(*(rate.states for rate in dependences(problem.system)))
    outer = tuple(k for k in range(len(problem.axes)) if k in depends)
    inner = tuple(k for k in range(len(problem.axes)) if k not in depends)
    axes = [problem.axes[k] for k in outer + inner]
    counts, periodic = [axis.count for axis in axes], [axis.periodic for axis in axes]
    if not inner:
        counts, periodic = [*counts, 1], [*periodic, False]
    return Layout(outer, inner, np.array(counts, dtype=np.int64), np.array(periodic))


def slab_states(problem: Gridded, layout: Layout, slabs: NDArray[np.int64] | None = None) -> NDArray[np.float64]:
    """Return the states (k, n) of slabs (k,), by default all, in the problem's order; inner axes at the lower end."""
    chosen = np.arange(layout.slabs) if slabs is None else slabs
    states = np.empty((len(chosen), len(problem.axes)))
    states[:] = [axis.lower for axis in problem.axes]
    if layout.outer:
        indices = np.unravel_index(chosen, tuple(layout.counts[: len(layout.outer)]))
        for k, index in zip(layout.outer, indices, strict=True):
            states[:, k] = _nodes(problem.axes[k])[index]
    return states


@lru_cache(maxsize=64)
def _nodes(axis: Axis) -> NDArray[np.float64]:
    return axis.nodes


def pairs(
    problem: TimeToReachProblem, controls: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Return controls (p, m) and disturbances (p, n) of all pairs, controls varying fastest, and the control count."""
    disturbances = problem.system.disturbance_samples(2)
    u = np.tile(controls, (len(disturbances), 1))
    d = np.repeat(disturbances, len(controls), axis=0)
    return u, d, len(controls)


def rates_under_all_pairs(
    system: System, states: NDArray[np.float64], u: NDArray[np.float64], d: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return f at every state (k, n) under every pair (p, ...), shape (k, p, n), even if f depends on no state."""
    rates = system.dynamics(states[:, None], u, d)
    return np.broadcast_to(rates, (len(states), len(u), states.shape[-1]))


def crossing_time(problem: TimeToReachProblem) -> float:
    """Return the time for the slowest axis to cross a cell at its top speed [s]; 0 if nothing moves."""
    layout = make_layout(problem)
    u, d, _ = pairs(problem, tried_controls(problem, layout))
    spacings = np.array([axis.spacing for axis in problem.axes])
    derivatives, top = Derivatives(problem.system, HeldPairs(u, d)), np.zeros(len(spacings))
    for block in blocks(layout.slabs, len(u)):
        states = slab_states(problem, layout, np.arange(block.start, block.stop))
        rates = np.abs(derivatives.of(states, spacings))
        top = np.fmax(top, np.where(np.isfinite(rates), rates, 0.0).max(axis=1))
    return float(1.0 / top[top > 0].min()) if top.any() else 0.0


def step_lengths(problem: TimeToReachProblem) -> tuple[float, ...]:
    """Return the lengths of the steps [cells] under each control.

    A step shorter than about a cell refers to its own node. Lengths without a common divisor reach every heading of a
    lattice. Each interpolation blurs the value a little, most where the optimal path runs along a kink (a car that
    brakes as late as possible), so long steps increase accuracy; the shortest step resolves the moment to switch. In a
    game, a long step would hold the disturbance longer than is optimal for it; and near obstacles, a robot that follows
    the values of long steps drives over the edges. Where a derivative jumps, a long step may leap over the jump.
    """
    if problem.jump:
        return (1.0, 2.0)
    game = any(disturbance.lower < disturbance.upper for disturbance in problem.system.disturbances)
    if len(problem.axes) <= FEW_AXES:
        return (2.0, 3.0, 7.0) if game else (2.0, 3.0, 7.0, 15.0)
    if game or problem.clearance is not None:
        return (2.0, 3.0)
    if not make_layout(problem).inner:
        # Grids with four axes are coarse: a step of one cell switches sooner, and halves the error of two pendulums.
        return (2.0, 3.0) if len(problem.axes) < _MANY_AXES else (1.0, 2.0)
    return (1.0, 7.0) if len(problem.axes) < _MANY_AXES else (1.0, 2.0, 7.0)


def tried_controls(problem: TimeToReachProblem, layout: Layout) -> NDArray[np.float64]:
    """Return the controls (k, m) of the steps: the problem's samples, or only the vertices of the box.

    The vertices suffice for a system affine in its controls; the other samples avoid chattering. If each node has its
    own steps in four or more dimensions, tables for all samples would take most of the memory.
    """
    if not layout.inner and len(layout.outer) >= _MANY_AXES and is_affine(problem.system):
        return problem.system.control_samples(2)
    samples = problem.control_samples
    low, high = problem.system.control_bounds
    free = (low < 0.0) & (high > 0.0)
    if free.any() and not (samples == np.where(free, 0.0, samples)).all(axis=-1).any():
        rest = np.where(free, 0.0, 0.5 * (low + high))
        return np.concatenate((samples, rest[None]))  # coasting: the middle between asymmetric bounds is not zero
    return samples


def blocks(count: int, width: int) -> Iterator[slice]:
    """Yield ranges of rows small enough for the working set to fit into the cache."""
    size = max(1, _BLOCK // width)
    for begin in range(0, count, size):
        yield slice(begin, min(begin + size, count))

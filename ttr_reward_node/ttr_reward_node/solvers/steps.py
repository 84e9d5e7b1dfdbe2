"""Steps of the semi-Lagrangian scheme: displacement of the system from each node under each control.

Robots move the same way at every position, so f does not depend on some of the axes. The steps are tabulated over the
other axes only (for a car, 72 headings rather than 734,472 nodes), with NumPy, from the single definition of f; the
compiled sweep is independent of the system.

A step lasts until the axis that moves fastest, in cells, has moved `cells` whole cells, however long that takes. So it
ends on a plane of the grid: no interpolation is needed along that axis, and a node never refers to itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, System
from ttr_reward_node.kernels.stencil import PER_CELL
from ttr_reward_node.problems.dependence import dependences, is_affine
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.held_motion import HeldPairs, Motion, Room, move_cells
from ttr_reward_node.solvers.threads import for_each

_BLOCK = 1 << 13  # number of steps computed at once, so that their arrays fit into the cache
_SOME = 4096  # number of nodes at which the usefulness of a control is judged
_FEW_AXES, _MANY_AXES = 2, 4
_STIFF = 0.2  # duration below which only the fastest axis moves, relative to the slowest axis crossing a cell
_PATIENCE = 1.5  # maximum duration relative to the fastest pair at a node, in games on more than two axes
_GRAZE = 0.25  # distance that a path may extend beyond a node without leaving it [cells]
_MOST_CODES = 1 << 16  # number of durations representable by 16 bits
PARTS = 8
"""Number of straight segments that approximate the path of a step."""
_FAR = 10_000.0  # reach that fits into 16 bits and is beyond any grid [cells]
_EDGE = 1e-3  # rounding error of a step truncated at a limit [cells]


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
        reach: Lowest and highest cell along each axis over all steps (slabs, n, 2).
        controls: Number of combinations of control and step length; the number of pairs is a multiple of it.
        crossing: Time to cross a cell along the slowest axis at its top speed [s].
    """

    held: HeldPairs
    lengths: NDArray[np.float64]
    codes: NDArray[np.uint16]
    durations: NDArray[np.float64]
    ends: NDArray[np.int16]
    ranges: NDArray[np.int8]
    reach: NDArray[np.int16]
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
            states[:, k] = problem.axes[k].nodes[index]
    return states


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
    top = np.zeros(len(spacings))
    for block in _blocks(layout.slabs, len(u)):
        states = slab_states(problem, layout, np.arange(block.start, block.stop))
        with np.errstate(all="ignore"):
            rates = np.abs(rates_under_all_pairs(problem.system, states, u, d))
        top = np.fmax(top, np.where(np.isfinite(rates), rates, 0.0).max(axis=(0, 1)))
    top /= spacings
    return float(1.0 / top[top > 0].min()) if top.any() else 0.0


def step_lengths(problem: TimeToReachProblem) -> tuple[float, ...]:
    """Return the lengths of the steps [cells] under each control.

    A step shorter than about a cell refers to its own node. Lengths without a common divisor reach every heading of a
    lattice. Each interpolation blurs the value a little, most where the optimal path runs along a kink (a car that
    brakes as late as possible), so long steps increase accuracy; the shortest step resolves the moment to switch. In a
    game, a long step would hold the disturbance longer than is optimal for it; and near obstacles, a robot that follows
    the values of long steps drives over the edges.
    """
    game = any(disturbance.lower < disturbance.upper for disturbance in problem.system.disturbances)
    if len(problem.axes) <= _FEW_AXES:
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


def make_steps(problem: TimeToReachProblem, layout: Layout) -> Steps:
    """Tabulate the steps: every control with every length of `step_lengths`."""
    cells = step_lengths(problem)
    u, d, controls = pairs(problem, tried_controls(problem, layout))
    spacings = np.array([axis.spacing for axis in problem.axes])
    crossing = crossing_time(problem)
    disturbances = len(u) // controls
    useful = _controls_to_keep(problem, layout, HeldPairs(u, d), crossing)
    keep = np.tile(useful, disturbances)
    held = HeldPairs(u[keep], d[keep])
    shape = (layout.slabs, disturbances, len(cells), int(useful.sum()))
    # During a long step, each player knows the other's next actions, which shifts the barriers of a pursuit on three or
    # more axes. On two axes the grid is finer, and a weak control next to a strong one needs long steps to move a cell.
    patience = _PATIENCE if disturbances > 1 and len(problem.axes) > _FEW_AXES else None
    durations = np.empty(shape, np.float32)
    ends = np.empty((*shape, len(layout.order)), np.int16)
    ranges = np.empty((*shape, len(layout.inner), 2), np.int8)
    reach = np.zeros((layout.slabs, len(layout.order), 2), np.int16)

    def tabulate(block: slice) -> None:
        x = slab_states(problem, layout, np.arange(block.start, block.stop))[:, None]
        room = _room(problem, layout, x)
        for i, length in enumerate(cells):
            motion = move_cells(problem.system, x, held, spacings, room, length, patience, shape[-1])
            low, high = motion.hull()
            h = np.where(_leaves(problem, layout, x, motion, (low, high)), 0.0, motion.durations)
            per = (len(x), disturbances, shape[-1])
            durations[block, :, i] = h.reshape(per)
            ends[block, :, i] = np.rint(layout.ordered(motion.moves) * PER_CELL).reshape(*per, -1)
            _widen(reach[block], layout, low, high)
            if layout.inner:
                along = motion.along(layout.inner).path(PARTS)
                ranges[block, :, i, ..., 0] = np.floor(np.minimum(along.min(axis=-2), 0.0) + _GRAZE).reshape(*per, -1)
                ranges[block, :, i, ..., 1] = np.ceil(np.maximum(along.max(axis=-2), 0.0) - _GRAZE).reshape(*per, -1)

    for_each(tabulate, _blocks(layout.slabs, len(held.u)))
    n_pairs = math.prod(shape[1:])
    codes, book = _numbered(durations.reshape(layout.slabs, n_pairs))
    u, d = (np.repeat(each.reshape(disturbances, 1, shape[-1], -1), len(cells), axis=1) for each in held)
    return Steps(
        held=HeldPairs(u.reshape(n_pairs, -1), d.reshape(n_pairs, -1)),
        lengths=np.tile(np.repeat(np.asarray(cells), shape[-1]), disturbances),
        codes=codes,
        durations=book,
        ends=ends.reshape(layout.slabs, n_pairs, -1),
        ranges=ranges.reshape(layout.slabs, n_pairs, len(layout.inner), 2),
        reach=reach,
        controls=len(cells) * shape[-1],
        crossing=crossing,
    )


def _blocks(count: int, width: int) -> Iterator[slice]:
    """Yield ranges of rows small enough for the working set to fit into the cache."""
    size = max(1, _BLOCK // width)
    for begin in range(0, count, size):
        yield slice(begin, min(begin + size, count))


def _numbered(durations: NDArray[np.float32]) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    """Return 16-bit codes for durations, and the durations by code; code 0 is a duration of 0.

    Exact if there are few distinct durations, as for a robot that moves the same way everywhere; otherwise to 1 part in
    5,000, an error that mostly averages out over successive steps.
    """
    codes = np.empty(durations.shape, np.uint16)
    if len(np.unique(durations.ravel()[: 2 * _MOST_CODES])) < _MOST_CODES:  # avoids sorting all of them in vain
        book = np.unique(durations)
        if len(book) < _MOST_CODES:
            zero = int(len(book) == 0 or book[0] > 0.0)  # code 0 means no step, even if every pair has one
            for begin in range(0, len(durations), _BLOCK):  # np.unique's return_inverse takes eight times the memory
                some = slice(begin, begin + _BLOCK)
                codes[some] = np.searchsorted(book, durations[some]) + zero
            return codes, np.concatenate((np.zeros(zero), book))
    least = float(durations.min(where=durations > 0.0, initial=np.inf))
    logs = np.linspace(math.log(least), math.log(float(durations.max())), _MOST_CODES - 1)
    for begin in range(0, len(durations), _BLOCK):
        some = slice(begin, begin + _BLOCK)
        with np.errstate(divide="ignore"):
            at = (np.log(durations[some]) - logs[0]) / (logs[1] - logs[0])
        codes[some] = np.where(durations[some] > 0.0, np.rint(np.maximum(at, 0.0)) + 1.0, 0.0)
    return codes, np.concatenate(([0.0], np.exp(logs)))


def _controls_to_keep(
    problem: TimeToReachProblem, layout: Layout, held: HeldPairs, crossing: float
) -> NDArray[np.bool_]:
    """Whether each control is kept: the vertices, and others unless all their steps are very short.

    For example, half of a torque that reverses a quadrotor's pitch rate within milliseconds achieves nothing that the
    full torque does not. The decision is based on the rates at a subset of the nodes.
    """
    controls = tried_controls(problem, layout)
    if not problem.system.controls:
        return np.ones(1, dtype=bool)
    vertex = np.isin(controls, problem.system.control_bounds).all(axis=-1)
    if vertex.all():
        return np.asarray(vertex)
    some = np.unique(np.linspace(0, layout.slabs - 1, _SOME).astype(np.int64))
    spacings = np.array([axis.spacing for axis in problem.axes])
    rates = rates_under_all_pairs(problem.system, slab_states(problem, layout, some), *held) / spacings
    with np.errstate(divide="ignore"):
        short = 1.0 / np.abs(rates).max(axis=-1) < _STIFF * crossing
    return np.asarray(vertex | ~short.reshape(-1, len(controls)).all(axis=0))


def _room(problem: TimeToReachProblem, layout: Layout, x: NDArray[np.float64]) -> Room:
    """Return the free space of states (k, 1, n): a step is truncated at a limit of an outer axis.

    Along an inner axis all nodes share the step, so it is not truncated; nodes from which it would leave the grid skip
    it.
    """
    below, above = np.full(x.shape, np.inf), np.full(x.shape, np.inf)
    for k in layout.outer:
        low, high = problem.limits[:, k]
        spacing = problem.axes[k].spacing
        below[..., k], above[..., k] = (x[..., k] - low) / spacing, (high - x[..., k]) / spacing
    return Room(below, above)


def _leaves(
    problem: TimeToReachProblem,
    layout: Layout,
    x: NDArray[np.float64],
    motion: Motion,
    hull: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> NDArray[np.bool_]:
    """Whether steps (k, p) from states (k, 1, n) leave the limits of an outer axis; `hull` is that of the motion.

    A step that starts beyond a limit, at the node next to it, only has to end within the limits.
    """
    doubtful, outside = np.zeros((2, *motion.durations.shape), dtype=bool)
    for k in layout.outer:
        (low, high), spacing = problem.limits[:, k], problem.axes[k].spacing
        below, above = (low - x[..., k]) / spacing, (high - x[..., k]) / spacing
        doubtful |= (hull[0][..., k] < below - 0.5 * _EDGE) | (hull[1][..., k] > above + 0.5 * _EDGE)
        way = x[..., k] + spacing * motion.moves[..., k]
        outside |= (way < low - _EDGE * spacing) | (way > high + _EDGE * spacing)
    row, column = np.nonzero(doubtful & ~outside)
    path, start = motion.of(row, column).path(PARTS), x[row, 0]
    for k in layout.outer:
        (low, high), spacing = problem.limits[:, k], problem.axes[k].spacing
        way = start[:, None, k] + spacing * path[..., k]
        beyond = (way < low - _EDGE * spacing) | (way > high + _EDGE * spacing)
        within = (start[:, k] >= low - _EDGE * spacing) & (start[:, k] <= high + _EDGE * spacing)
        outside[row, column] |= np.where(within, beyond.any(axis=-1), beyond[..., -1])
    return outside


def _widen(reach: NDArray[np.int16], layout: Layout, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
    """Extend the reach (k, n, 2) of states by boxes (k, p, n) [cells] around their steps."""
    lowest = reduce(np.minimum, (low[:, p] for p in range(low.shape[1])))
    highest = reduce(np.maximum, (high[:, p] for p in range(high.shape[1])))
    reach[..., 0] = np.minimum(reach[..., 0], np.floor(np.maximum(layout.ordered(lowest), -_FAR)))
    reach[..., 1] = np.maximum(reach[..., 1], np.ceil(np.minimum(layout.ordered(highest), _FAR)))

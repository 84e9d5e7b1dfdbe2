"""Steps of the semi-Lagrangian scheme: the displacement of the system from each node under each control.

Robots move the same way wherever they are: f does not depend on the position, on some axes at all. So the steps are
tabulated over the other axes alone (the 72 headings of a car, not its 734,472 nodes), with NumPy, from the one
definition of f; and the compiled sweep needs to know no system.

A step lasts until the axis that moves fastest, in cells, has moved `cells` whole cells, however long that takes. So it
ends on a plane of the grid: there is nothing to interpolate along that axis, and a node never refers to itself.
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

_BLOCK = 1 << 13  # steps that are computed at once: their arrays stay in the cache
_SOME = 4096  # nodes whose rates tell which controls are worth trying
_FEW_AXES, _MANY_AXES = 2, 4
_STIFF = 0.2  # of the time in which the slowest axis crosses a cell at its top speed: in less only the fastest moves
_PATIENCE = 1.5  # in a game in space: durations of the fastest pair at a node for which the others hold on at most
_GRAZE = 0.25  # cells: a path that comes this far beyond a node has not left it
_MOST_CODES = 1 << 16  # durations that 16 bits can tell apart
PARTS = 8
"""Straight pieces that stand for the path of a step."""
_FAR = 10_000.0  # cells: as far as 16 bits hold, and beyond any grid
_EDGE = 1e-3  # cells: a step that was cut short at a limit ends there only to rounding


class Gridded(Protocol):
    """A problem on a grid: a system and an axis for each of its states."""

    @property
    def system(self) -> System:
        """Dynamics of the problem."""

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes, one for each state."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The order of the axes in memory: first those that f depends on (`outer`), then the others (`inner`).

    Attributes:
        outer, inner: Indices of the problem's axes on which f depends, and of the others.
        counts: Number of nodes on each axis in this order.
        periodic: Whether each axis is periodic, in this order.
    """

    outer: tuple[int, ...]
    inner: tuple[int, ...]
    counts: NDArray[np.int64]
    periodic: NDArray[np.bool_]

    @property
    def order(self) -> tuple[int, ...]:
        """All axes."""
        return self.outer + self.inner

    def ordered(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values (..., n) of the problem's axes in this order."""
        return values if self.order == tuple(range(len(self.order))) else values[..., self.order]

    @property
    def slabs(self) -> int:
        """Number of nodes of the outer axes: f is the same all over the inner ones."""
        return math.prod(self.counts[: len(self.outer)].tolist())


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of each slab under each pair of disturbance and control, axes in the layout's order.

    Attributes:
        held: Controls and disturbances of the pairs: disturbances vary slowest, then lengths, then controls.
        lengths: Length of each pair's step [cells].
        codes: Number of each step's duration (slabs, pairs), 0 where nothing moves, or where the step would leave the
            limits of an outer axis.
        durations: Durations by their number [s]; 0 at number 0.
        ends: Displacements at the end (slabs, pairs, n) [1 / PER_CELL cells].
        ranges: Lowest and highest cell along each inner axis that a step comes to (slabs, pairs, inner, 2).
        reach: Lowest and highest cell along each axis that any step comes to (slabs, n, 2).
        controls: Number of controls, each with each length of step; the number of pairs is a multiple of it.
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
    """Find out which axes f depends on."""
    depends = frozenset[int]().union(*(rate.states for rate in dependences(problem.system)))
    outer = tuple(k for k in range(len(problem.axes)) if k in depends)
    inner = tuple(k for k in range(len(problem.axes)) if k not in depends)
    axes = [problem.axes[k] for k in outer + inner]
    counts, periodic = [axis.count for axis in axes], [axis.periodic for axis in axes]
    if not inner:
        counts, periodic = [*counts, 1], [*periodic, False]
    return Layout(outer, inner, np.array(counts, dtype=np.int64), np.array(periodic))


def slab_states(problem: Gridded, layout: Layout, slabs: NDArray[np.int64] | None = None) -> NDArray[np.float64]:
    """Return the states (k, n) of slabs (k,), all unless given, in the problem's order; inner ones at the lower end."""
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
    """Return controls (p, m) and disturbances (p, n) of all pairs, controls the faster index, and how many they are."""
    disturbances = problem.system.disturbance_samples(2)
    u = np.tile(controls, (len(disturbances), 1))
    d = np.repeat(disturbances, len(controls), axis=0)
    return u, d, len(controls)


def rates_under_all_pairs(
    system: System, states: NDArray[np.float64], u: NDArray[np.float64], d: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return f at every state (k, n) under every pair (p, ...), shape (k, p, n), also where f depends on no state."""
    rates = system.dynamics(states[:, None], u, d)
    return np.broadcast_to(rates, (len(states), len(u), states.shape[-1]))


def crossing_time(problem: TimeToReachProblem) -> float:
    """Return how long the slowest axis takes to cross a cell at its top speed [s]; 0 where nothing moves."""
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

    Under about one cell a node refers to itself. Lengths without a common divisor reach every heading of a lattice.
    Each interpolation blurs the value a little, most where the best path runs along a kink (a car that brakes as late
    as it can), so long steps make it exacter; the shortest finds the moment to switch. In a game both would hold a
    disturbance for longer than it would hold itself, and near obstacles whoever steers by the values of long steps
    drives over the edges.
    """
    game = any(disturbance.lower < disturbance.upper for disturbance in problem.system.disturbances)
    if len(problem.axes) <= _FEW_AXES:
        return (2.0, 3.0, 7.0) if game else (2.0, 3.0, 7.0, 15.0)
    if game or problem.clearance is not None:
        return (2.0, 3.0)
    if not make_layout(problem).inner:
        # Grids of four axes are coarse: a step of one cell switches sooner. It halves the error of a pair of pendulums.
        return (2.0, 3.0) if len(problem.axes) < _MANY_AXES else (1.0, 2.0)
    return (1.0, 7.0) if len(problem.axes) < _MANY_AXES else (1.0, 2.0, 7.0)


def tried_controls(problem: TimeToReachProblem, layout: Layout) -> NDArray[np.float64]:
    """Return the controls (k, m) of the steps: the problem's samples, or the vertices of the box alone.

    The vertices are enough for a system that is affine in its controls; the others save switching to and fro. Where
    each node has steps of its own in four or more dimensions, the tables of all would take most of the memory.
    """
    if not layout.inner and len(layout.outer) >= _MANY_AXES and is_affine(problem.system):
        return problem.system.control_samples(2)
    samples = problem.control_samples
    low, high = problem.system.control_bounds
    free = (low < 0.0) & (high > 0.0)
    if free.any() and not (samples == np.where(free, 0.0, samples)).all(axis=-1).any():
        rest = np.where(free, 0.0, 0.5 * (low + high))
        return np.concatenate((samples, rest[None]))  # to coast: between bounds that differ, the middle is no rest
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
    # Who holds on for longer knows what the other one does next: in space that moves the barriers of a pursuit. In a
    # plane the grid is finer, and a weak control beside a strong one needs its time, or it would never move a cell.
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
    """Yield ranges of so many rows that what is computed at once fits into the cache."""
    size = max(1, _BLOCK // width)
    for begin in range(0, count, size):
        yield slice(begin, min(begin + size, count))


def _numbered(durations: NDArray[np.float32]) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    """Return numbers of 16 bits for durations, and the durations by their numbers; 0 is number 0.

    Exact where there are few, as of a robot that moves the same way wherever it is; else to 1 part in 5,000, of which
    steps in a row average the most.
    """
    codes = np.empty(durations.shape, np.uint16)
    if len(np.unique(durations.ravel()[: 2 * _MOST_CODES])) < _MOST_CODES:  # else sorting them all would be in vain
        book = np.unique(durations)
        if len(book) < _MOST_CODES:
            zero = int(len(book) == 0 or book[0] > 0.0)  # number 0 means no step, also where every pair has one
            for begin in range(0, len(durations), _BLOCK):  # NumPy's own inverse takes eight times the memory
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
    """Whether each control is kept: the vertices, and those between that do not always make for very short steps.

    Half of a torque that turns a quadrotor's pitch rate round in milliseconds leads nowhere that the whole of it does
    not. Rates at some of the nodes decide.
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
    """Return the room of states (k, 1, n): a step is cut short at a limit of an outer axis.

    Along an inner axis, all nodes share the step: it is not cut, and who would leave by it does not take it.
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
    """Whether steps (k, p) from states (k, 1, n) leave the limits of an outer axis; `hull` is the motion's.

    A step from beyond a limit, which may begin at the last node before it, only has to end within.
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
    """Widen the reach (k, n, 2) of states to boxes (k, p, n) [cells] around their steps."""
    lowest = reduce(np.minimum, (low[:, p] for p in range(low.shape[1])))
    highest = reduce(np.maximum, (high[:, p] for p in range(high.shape[1])))
    reach[..., 0] = np.minimum(reach[..., 0], np.floor(np.maximum(layout.ordered(lowest), -_FAR)))
    reach[..., 1] = np.maximum(reach[..., 1], np.ceil(np.minimum(layout.ordered(highest), _FAR)))

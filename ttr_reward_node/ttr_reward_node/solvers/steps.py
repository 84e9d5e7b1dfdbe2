"""Steps of the semi-Lagrangian scheme: the displacement of the system from each node under each control.

Robots move the same way wherever they are: f does not depend on the position, on some axes at all. So the steps are
tabulated over the other axes alone (the 72 headings of a car, not its 734,472 nodes), with NumPy, from the one
definition of f; and the compiled sweep needs to know no system.

A step lasts until the axis that moves fastest, in cells, has moved `cells` whole cells. So it ends on a plane of the
grid: there is nothing to interpolate along that axis, and a node never refers to itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, System
from ttr_reward_node.problems.dependence import dependences
from ttr_reward_node.problems.problem import TimeToReachProblem

_BLOCK = 1 << 16  # steps that are computed at once
_TO_PLANE = 4  # corrections of a step's duration until it ends on the plane
_STIFF = 0.2  # of the longest step: in shorter ones nothing but the fastest axis moves


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

    @property
    def slabs(self) -> int:
        """Number of nodes of the outer axes: f is the same all over the inner ones."""
        return math.prod(self.counts[: len(self.outer)].tolist())


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of each slab under each pair of disturbance and control, axes in the layout's order.

    Attributes:
        durations: Durations (slabs, pairs) [s]; disturbances are the slower index of the pairs; 0 where nothing moves.
        moves: Displacements (slabs, pairs, 2, n) [cells] after half of the duration and after all of it.
        controls: Number of controls, each with each length of step; the number of pairs is a multiple of it.
        longest: Time to cross a cell along the slowest axis at its top speed [s].
    """

    durations: NDArray[np.float64]
    moves: NDArray[np.float32]
    controls: int
    longest: float


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


def slab_states(problem: Gridded, layout: Layout) -> NDArray[np.float64]:
    """States (slabs, n) of the outer nodes, in the problem's order; inner components are at their axis's lower end."""
    states = np.empty((layout.slabs, len(problem.axes)))
    states[:] = [axis.lower for axis in problem.axes]
    if layout.outer:
        nodes = np.meshgrid(*(problem.axes[k].nodes for k in layout.outer), indexing="ij")
        states[:, layout.outer] = np.stack(nodes, axis=-1).reshape(layout.slabs, -1)
    return states


def pairs(
    problem: TimeToReachProblem, counts: int | tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Return controls (p, m) and disturbances (p, n) of all pairs, and the number of controls, the faster index.

    `counts` is how many samples of each control there are; two are the vertices of the box.
    """
    controls = problem.system.control_samples(counts) if problem.system.controls else np.zeros((1, 0))
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
    u, d, _ = pairs(problem, 2)
    spacings = np.array([axis.spacing for axis in problem.axes])
    return _longest(problem.system, slab_states(problem, make_layout(problem)), u, d, spacings)


def make_steps(problem: TimeToReachProblem, layout: Layout, cells: Sequence[float]) -> Steps:
    """Tabulate the steps; `cells` is how far they go: every control with every one of these lengths."""
    u, d, controls = pairs(problem, problem.control_counts)
    states = slab_states(problem, layout)
    lengths, disturbances, n = len(cells), len(u) // controls, len(layout.order)
    durations = np.empty((len(states), disturbances, lengths, controls))
    spacings = np.array([axis.spacing for axis in problem.axes])
    longest = _longest(problem.system, states, u, d, spacings)
    size = max(1, _BLOCK // len(u))
    for begin in range(0, len(states), size):
        block = slice(begin, begin + size)
        x = states[block, None]
        for i, length in enumerate(cells):
            h = _durations(problem, layout, x, (u, d), length, longest)
            durations[block, :, i] = h.reshape(-1, disturbances, controls)
    # Before the moves, which take the most memory, are allocated.
    useful = np.flatnonzero(_controls_to_keep(problem, durations, cells, longest))
    if len(useful) < controls:
        durations = np.take(durations, useful, axis=-1)
        u, d = (pair.reshape(disturbances, controls, -1)[:, useful].reshape(-1, pair.shape[-1]) for pair in (u, d))
    pairs_ = disturbances * lengths * len(useful)
    moves = np.zeros((len(states), disturbances, lengths, len(useful), 2, len(layout.counts)), dtype=np.float32)
    for begin in range(0, len(states), size):
        block = slice(begin, begin + size)
        x = states[block, None]
        for i in range(lengths):
            h = durations[block, :, i].reshape(len(x), -1)
            for half in (0, 1):
                dt = (0.5 * (half + 1) * h)[..., None]
                move = _snap((problem.system.step(x, u, d, dt=dt) - x) / spacings)[..., layout.order]
                moves[block, :, i, :, half, :n] = move.reshape(-1, disturbances, len(useful), n)
    return Steps(
        durations=durations.reshape(len(states), pairs_),
        moves=moves.reshape(len(states), pairs_, 2, len(layout.counts)),
        controls=lengths * len(useful),
        longest=longest,
    )


def _controls_to_keep(
    problem: TimeToReachProblem, durations: NDArray[np.float64], cells: Sequence[float], longest: float
) -> NDArray[np.bool_]:
    """Whether each control is kept: the vertices, and those between that do not always make for very short steps.

    Half of a torque that turns a quadrotor's pitch rate round in milliseconds leads nowhere that the whole of it does
    not.
    """
    vertex = np.isin(problem.system.control_samples(problem.control_counts), problem.system.control_bounds)
    short = durations < _STIFF * longest * np.asarray(cells)[:, None]
    return np.asarray(vertex.all(axis=-1) | ~short.all(axis=(0, 1, 2)))


def _longest(
    system: System,
    states: NDArray[np.float64],
    u: NDArray[np.float64],
    d: NDArray[np.float64],
    spacings: NDArray[np.float64],
) -> float:
    """Time in which the slowest axis crosses a cell at its top speed [s]."""
    top = np.zeros(len(spacings))
    size = max(1, _BLOCK // len(u))
    for begin in range(0, len(states), size):
        rates = np.abs(rates_under_all_pairs(system, states[begin : begin + size], u, d))
        top = np.maximum(top, rates.max(axis=(0, 1)))
    top /= spacings
    return float(1.0 / top[top > 0].min()) if top.any() else 0.0


def _durations(
    problem: TimeToReachProblem,
    layout: Layout,
    x: NDArray[np.float64],
    pair: tuple[NDArray[np.float64], NDArray[np.float64]],
    cells: float,
    crossing: float,
) -> NDArray[np.float64]:
    """Durations (block, pairs) of steps that end `cells` away, or at the edge of the grid on an outer axis.

    Args:
        problem: Problem with the system and the axes.
        layout: Order of the axes.
        x: States at which the steps begin (block, 1, n).
        pair: Controls (pairs, m) and disturbances (pairs, n).
        cells: Length of the steps [cells].
        crossing: Time in which the slowest axis crosses a cell at its top speed [s], which limits the durations.
    """
    u, d = pair
    spacings, longest = np.array([axis.spacing for axis in problem.axes]), cells * crossing
    rates = np.abs(rates_under_all_pairs(problem.system, x[:, 0], u, d)) / spacings
    with np.errstate(divide="ignore"):
        h = np.minimum(cells / rates.max(axis=-1), longest)
    # Distances to the edges; without limit on periodic and inner axes.
    room = np.full((2, len(x), 1, len(spacings)), np.inf)
    for k in layout.outer:
        axis = problem.axes[k]
        if not axis.periodic:
            room[0, ..., k] = (x[..., k] - axis.lower) / spacings[k]
            room[1, ..., k] = (axis.upper - x[..., k]) / spacings[k]
    for _ in range(_TO_PLANE):
        move = (problem.system.step(x, u, d, dt=h[..., None]) - x) / spacings
        limit = np.minimum(np.where(move < 0, room[0], room[1]), cells)
        # From the edge outwards there is no room at all: the step stays too long, and is refused later.
        limit = np.where(limit < 1e-6, cells, limit)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.nanmin(np.where(move == 0, np.inf, limit / np.abs(move)), axis=-1)
        h = np.minimum(h * scale, longest)
    return h


def _snap(moves: NDArray[np.float64], tolerance: float = 1e-4) -> NDArray[np.float64]:
    """Round moves that are within `tolerance` of whole cells."""
    whole = np.round(moves)
    return np.where(np.abs(moves - whole) < tolerance, whole, moves)

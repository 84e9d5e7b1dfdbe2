"""Plain value iteration on a finer grid: for what has no closed form, and to check the closed forms.

T(x) = max over d, min over u of  dt + T(x + f dt),  with held u and d, from above and until nothing changes. The
steps are Runge-Kutta's; each crosses about two cells of the finer grid, so that its error of interpolation comes
seldom. Whether a step meets the target or leaves the grid is looked up on the way, not at the nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_core import Axis
from referee.case import Array, Reference
from ttr_reward_node import TimeToReachProblem

FAR = 1e9
"""Stands for infinity, in units of the shortest step: interpolation needs numbers."""
CELLS_A_STEP = 2.0
LOOKS = 8
SLOWEST = 1e-4
"""Least speed of a step that is two cells long, relative to the largest."""
SWEEPS = 4000


def plain_times(problem: TimeToReachProblem, finer: int = 3, samples: int | Sequence[int] = 3) -> Reference:
    """Return the times to reach by value iteration.

    Args:
        problem: Problem to solve; its obstacles are not looked at.
        finer: Number of cells for each of the problem's.
        samples: Number of samples of each control; the disturbances are tried at their bounds.
    """
    axes = [replace(axis, count=_finer_count(axis, finer)) for axis in problem.axes]
    nodes = np.stack(np.meshgrid(*(axis.nodes for axis in axes), indexing="ij"), axis=-1).reshape(-1, len(axes))
    controls, gusts = _samples(problem, samples)
    pairs = list(product(gusts, controls))
    spacing = np.array([axis.spacing for axis in axes])
    pairs = [(np.broadcast_to(d, (len(nodes), len(d))), np.broadcast_to(u, (len(nodes), len(u)))) for d, u in pairs]
    speeds = [np.broadcast_to(np.abs(problem.system.dynamics(nodes, u, d)), nodes.shape) for d, u in pairs]
    rates = np.array([(speed / spacing).max(axis=1) for speed in speeds])
    steps = CELLS_A_STEP / np.maximum(rates, SLOWEST * rates.max())
    costs, places = np.empty(steps.shape), np.empty((*steps.shape, len(axes)))
    least = float(steps.min())
    far = FAR * least
    for k, (d, u) in enumerate(pairs):
        costs[k], places[k] = _step(problem, axes, nodes, u, d, steps[k], far)
    times = np.where(_contains(problem, nodes), 0.0, far)
    counts = np.array([axis.count for axis in axes])
    rounds = np.array([axis.periodic for axis in axes])
    for _ in range(SWEEPS):
        if _sweep(times, costs, places, counts, rounds, len(gusts), far) < 1e-4 * least:
            break
    else:
        raise RuntimeError("plain value iteration does not converge")
    return _interpolator(np.where(times > 1e-3 * far, np.inf, times), axes)


def _finer_count(axis: Axis, finer: int) -> int:
    return axis.count * finer if axis.periodic else (axis.count - 1) * finer + 1


def _samples(problem: TimeToReachProblem, counts: int | Sequence[int]) -> tuple[list[Array], list[Array]]:
    system = problem.system
    controls = list(system.control_samples(counts)) if system.controls else [np.zeros(0)]
    return controls, list(system.disturbance_samples(2))


def _contains(problem: TimeToReachProblem, states: Array) -> NDArray[np.bool_]:
    wrapped = problem.system.wrap(states)
    return problem.target.contains(problem.system.state_names, wrapped)


def _step(
    problem: TimeToReachProblem, axes: Sequence[Axis], nodes: Array, u: Array, d: Array, dt: Array, far: float
) -> tuple[Array, Array]:
    """Return the time that a step takes, and its end in cells, NaN where it needs no value there."""
    bounds = [
        (-np.inf, np.inf) if state.periodic else (max(axis.lower, state.lower), min(axis.upper, state.upper))
        for axis, state in zip(axes, problem.system.states, strict=True)
    ]
    lows, highs = np.array(bounds).T
    slack = 1e-9 * (np.array([axis.upper - axis.lower for axis in axes]))
    at, cost, open_ = nodes, dt.copy(), np.ones(len(nodes), dtype=bool)
    ended = np.zeros(len(nodes), dtype=bool)
    for look in range(LOOKS):
        at = problem.system.step(at, u, d, dt=dt[:, None] / LOOKS)
        out = open_ & ((at < lows - slack) | (at > highs + slack)).any(axis=1)
        cost[out], ended[out] = far, True
        met = open_ & ~out & _contains(problem, at)
        cost[met], ended[met] = (look + 0.5) / LOOKS * dt[met], True
        open_ &= ~(out | met)
    places = (at - [axis.lower for axis in axes]) / [axis.spacing for axis in axes]
    places[ended, 0] = np.nan
    return cost, places


@njit
def _sweep(
    times: Array,
    costs: Array,
    places: Array,
    counts: Array,
    rounds: NDArray[np.bool_],
    gusts: int,
    far: float,
) -> float:  # pragma: no cover
    """Update all nodes in place, forwards and backwards; return the largest change."""
    pairs, n = costs.shape
    controls = pairs // gusts
    change = 0.0
    for way in range(2):
        for i in range(n):
            node = i if way == 0 else n - 1 - i
            if times[node] == 0.0:
                continue
            worst = 0.0
            for g in range(gusts):
                best = far
                for c in range(controls):
                    k = g * controls + c
                    time = costs[k, node]
                    if not np.isnan(places[k, node, 0]):
                        time += _between(times, places[k, node], counts, rounds)
                    best = min(best, time)
                worst = max(worst, best)
            if worst < times[node]:
                change = max(change, times[node] - worst)
                times[node] = worst
    return change


@njit
def _between(times: Array, place: Array, counts: Array, rounds: NDArray[np.bool_]) -> float:  # pragma: no cover
    """Return the value between the nodes, linear along each axis."""
    n = len(counts)
    value = 0.0
    for corner in range(1 << n):
        weight, index = 1.0, 0
        for k in range(n):
            cell = int(np.floor(place[k]))
            if not rounds[k]:
                cell = min(max(cell, 0), counts[k] - 2)
            share = place[k] - cell
            if corner >> k & 1:
                cell += 1
            else:
                share = 1.0 - share
            weight *= share
            index = index * counts[k] + cell % counts[k]
        if weight > 1e-12:
            value += weight * times[index]
    return value


@njit
def _between_all(
    times: Array, places: Array, counts: Array, rounds: NDArray[np.bool_], out: Array
) -> None:  # pragma: no cover
    for i in range(len(places)):
        out[i] = _between(times, places[i], counts, rounds)


def _interpolator(times: Array, axes: Sequence[Axis]) -> Reference:
    """Return times at states: linear between the nodes, +inf next to an unreachable one."""
    counts, rounds = np.array([axis.count for axis in axes]), np.array([axis.periodic for axis in axes])

    def interpolated(states: Array) -> Array:
        places = (states - [axis.lower for axis in axes]) / [axis.spacing for axis in axes]
        found = np.empty(len(states))
        _between_all(times, places, counts, rounds, found)
        return found

    return interpolated

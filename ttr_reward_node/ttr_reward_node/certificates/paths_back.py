"""Paths that arrive by construction: integrated backward from the target and from states that reach it.

Following such a path forward arrives within its duration t. So no value phi on it may exceed that, let alone be
infinite: phi(x) <= t + phi(end) for every control, by dynamic programming. A backward path heads for states where the
solution predicts the longest times, so it finds reachable states marked unreachable, and times that are too long.

On a grid, both sides of the inequality are known only to a few cells. The start takes the smallest value within two
cells in each direction, the end the largest. A path stays half a cell away from obstacles, and within the limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ValueGrid, position_indices
from ttr_reward_node.certificates.local_steps import LocalSteps
from ttr_reward_node.problems.problem import TimeToReachProblem

Array = NDArray[np.float64]
_AROUND = 2  # uncertainty of either side [cells]
_STEP = 1.0  # length of a step [cells]
_HOLD = 6  # maximum number of steps for which a control is held
_CHOICE = 3  # number of candidate controls per choice
_STEPS, _STEPS_OF_A_GAME = 64, 12
_LOOK, _LOOK_OF_A_GAME = 2, 6  # steps between two checks of the value
_PATIENCE = 3  # number of forward steps against another disturbance, per backward step
_FEINTS = 4  # number of disturbances that switch at random between their extremes
_FROM_TARGET = 128  # number of paths from the target itself
_APART = 0.5  # distance kept from obstacles [cells]
_RATIO, _CELLS = 1.15, 3.0  # a value may exceed the path's time by this factor, plus the time to cross this many cells


@dataclass(frozen=True, eq=False)
class PathsBack:
    """Result of the search along backward paths.

    Attributes:
        paths: Number of paths.
        contradictions: Number of paths that contradict the solution.
        state: State (n,) with the largest contradiction; None without contradictions.
        promised: Smallest value within two cells of that state [s].
        possible: Time in which that state actually arrives [s].
    """

    paths: int
    contradictions: int
    state: Array | None
    promised: float
    possible: float


@dataclass(frozen=True, eq=False)
class Held:
    """Controls (N, m), each held for `number` steps of a given duration (N,) [s]."""

    controls: Array
    duration: Array
    number: int


def search(value: ValueGrid, problem: TimeToReachProblem, states: Array, random: np.random.Generator) -> PathsBack:
    """Integrate backward from the target and from states (N, n) that reach it.

    In a game, a path holds a single control for a few cells, backward against one of the extreme disturbances. Its time
    is then the longest over forward simulations against every extreme disturbance and a few that switch at random
    between the extremes.
    """
    steps, around = LocalSteps(problem), Surroundings(value, problem)
    low, high = problem.system.disturbance_bounds
    played = bool((low < high).any())
    if played:
        states = states[: len(states) // 2]  # each path costs much more in a game
    begins = np.concatenate((in_target(problem, _FROM_TARGET // 2 if played else _FROM_TARGET, random), states))
    at_begin = np.concatenate((np.zeros(len(begins) - len(states)), around.largest(states)))
    kept = np.isfinite(at_begin) & ~steps.beyond(begins) & (steps.clearance(begins) > _APART)
    x, elapsed, at_begin = begins[kept], np.zeros(kept.sum()), at_begin[kept]
    paths = len(x)
    worst, place = np.ones(paths), x.copy()
    found = np.zeros((paths, 2))
    alive = np.arange(paths)
    u, hold = np.zeros((paths, len(problem.system.controls))), np.zeros(paths, dtype=int)
    extremes = problem.system.disturbance_samples(2)
    d = extremes[random.integers(len(extremes), size=paths)]
    for number in range(1, (_STEPS_OF_A_GAME if played else _STEPS) + 1):
        fresh = alive[hold[alive] == 0]
        if len(fresh):
            u[fresh] = _bold_controls(value, steps, x[fresh], d[fresh], random)
            hold[fresh] = _STEPS_OF_A_GAME if played else random.integers(1, _HOLD + 1, len(fresh))
        hold[alive] -= 1
        h = steps.durations(x[alive], u[alive], d[alive], _STEP)
        ends = steps.move(x[alive], u[alive], d[alive], -h)
        points = steps.chord(x[alive], ends)
        free = np.isfinite(h) & ~steps.beyond(points).any(axis=0) & (steps.clearance(points) > _APART).all(axis=0)
        alive, h, ends = alive[free], h[free], ends[free]
        if not len(alive):
            break
        x[alive] = steps.on_grid(ends)
        elapsed[alive] += h
        if number % (_LOOK_OF_A_GAME if played else _LOOK):
            continue
        possible = elapsed[alive] + at_begin[alive]
        if played:
            held = Held(u[alive], elapsed[alive] / number, number)
            possible = _longest_way(steps, around, x[alive], held, random)
        promised = around.least(x[alive])
        slack = _CELLS * elapsed[alive] / number
        ratio = np.divide(promised, _RATIO * possible + slack, out=np.zeros(len(alive)), where=np.isfinite(possible))
        larger = ratio > worst[alive]
        rows = alive[larger]
        worst[rows], place[rows] = ratio[larger], x[rows]
        found[rows] = np.stack((promised, possible), axis=-1)[larger]
    wrong = worst > 1.0
    if not wrong.any():
        return PathsBack(paths, 0, None, 0.0, 0.0)
    # Among the largest contradictions, take the one that arrives soonest: it is the easiest to verify.
    row = int(np.lexsort((found[:, 1], -worst))[0])
    return PathsBack(paths, int(wrong.sum()), place[row], float(found[row, 0]), float(found[row, 1]))


def _bold_controls(value: ValueGrid, steps: LocalSteps, x: Array, d: Array, random: np.random.Generator) -> Array:
    """Return, from a few random controls per state, those (N, m) that lead back to the largest predicted time."""
    problem = steps.problem
    samples, (low, high) = problem.control_samples, problem.system.control_bounds
    offered = samples[random.integers(len(samples), size=(len(x), _CHOICE))]
    offered[:, -1] = random.uniform(low, high, (len(x), samples.shape[1]))
    h = steps.durations(x[:, None], offered, d[:, None], 2.0 * _STEP)
    ends = steps.move(x[:, None], offered, d[:, None], -h)
    with np.errstate(invalid="ignore"):
        claims = value.value(steps.on_grid(ends)) - h
    lost = steps.beyond(ends) | np.isnan(claims)
    best = np.where(lost, -np.inf, claims).argmax(axis=1)
    return offered[np.arange(len(x)), best]


def _longest_way(steps: LocalSteps, around: Surroundings, x: Array, held: Held, random: np.random.Generator) -> Array:
    """Return the worst-case time (N,) over the disturbances in which states (N, n) arrive by the held control [s].

    The path may switch from the held control to following the solution at any check, if that reaches the target sooner.
    """
    extremes, worst = steps.problem.system.disturbance_samples(2), np.zeros(len(x))
    for play in range(len(extremes) + _FEINTS):
        at, soonest, lost = x, np.full(len(x), np.inf), np.zeros(len(x), dtype=bool)
        for step in range(1, _PATIENCE * held.number + 1):
            d = extremes[play] if play < len(extremes) else extremes[random.integers(len(extremes), size=len(x))]
            end = steps.move(at, held.controls, d, held.duration)
            points = steps.chord(at, end)
            there = steps.problem.reached(points).any(axis=0) & ~lost
            lost |= steps.beyond(end) | (steps.clearance(points) <= _APART).any(axis=0)
            at = steps.on_grid(np.where(lost[:, None], x, end))
            soonest = np.where(there, np.minimum(soonest, step * held.duration), soonest)
            if step % _LOOK == 0:
                other = np.where(lost, np.inf, around.largest(at))
                soonest = np.minimum(soonest, step * held.duration + other)
        worst = np.maximum(worst, soonest)
    return worst


def in_target(problem: TimeToReachProblem, count: int, random: np.random.Generator) -> Array:
    """Draw up to `count` states (..., n) in the target."""
    low, high = np.array([[axis.lower, axis.upper] for axis in problem.axes]).T
    low, high = np.clip([low, high], *problem.limits)
    for k, axis in enumerate(problem.axes):
        if axis.name in problem.target.intervals:
            begin, end = problem.target.intervals[axis.name]
            low[k], high[k] = (begin, end) if axis.periodic else (max(low[k], begin), min(high[k], end))
    disc = problem.target.disc
    if disc is not None:
        for k, middle in zip(position_indices(problem.system.state_names), disc.centre, strict=True):
            low[k], high[k] = max(low[k], middle - disc.radius), min(high[k], middle + disc.radius)
    drawn = problem.wrap(random.uniform(low, np.maximum(low, high), (2 * count, len(low))))
    return drawn[problem.reached(drawn)][:count]


class Surroundings:
    """Smallest and largest values within two cells of a state.

    Args:
        value: Values at the nodes.
        problem: Problem with the axes.
    """

    def __init__(self, value: ValueGrid, problem: TimeToReachProblem) -> None:
        self._values, self._axes = value.values, problem.axes
        self._offsets = np.array(list(product((-_AROUND, 0, _AROUND), repeat=len(problem.axes))))

    def least(self, states: Array) -> Array:
        """Return the smallest value (N,) around states (N, n) on the grid [s]."""
        return np.asarray(self._around(states).min(axis=1))

    def largest(self, states: Array) -> Array:
        """Return the largest value (N,) around states (N, n) on the grid [s]."""
        return np.asarray(self._around(states).max(axis=1))

    def _around(self, states: Array) -> Array:
        index = []
        for k, axis in enumerate(self._axes):
            nearest = np.round((states[:, k] - axis.lower) / axis.spacing).astype(np.int64)
            at = nearest[:, None] + self._offsets[:, k]
            index.append(at % axis.count if axis.periodic else np.clip(at, 0, axis.count - 1))
        return self._values[tuple(index)].astype(np.float64)

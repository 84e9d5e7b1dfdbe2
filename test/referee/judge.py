"""Judgement of a solution of one system: what it calls unreachable or reachable wrongly, and how far its times are off.

States are drawn evenly from the grid without two cells at its edges, where one that leaves has failed. A state whose
fate changes within two cells (in the grid's cells, along all axes at once) of it, or which the reference does not know
there, is nobody's fault. Relative errors of times are taken where the target is farther than two cells: the times near
it are as small as the error of one cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from referee.case import Array, Case
from ttr_reward_node import TimeToReachProblem

STATES = 2000
CELLS = 2
MEDIAN_LIMIT = 0.02
REACHABLE_LIMIT = 0.005
"""Fraction of the unreachable states that may get a time: nodes next to the boundary lend theirs to their cells."""


@dataclass(frozen=True)
class Verdict:
    """Judgement of a solution.

    Attributes:
        seed: Seed of the system.
        words: Its numbers.
        states: Number of states whose fate the reference knows.
        reachable: Number of those that can reach the target.
        lost: Number of those which the solution calls unreachable.
        gained: Number of the unreachable ones to which the solution gives a time.
        median: Median of |T - reference| / reference; NaN without a state to compare.
        worst: Largest of it.
        at: State that was lost, else gained, else the one with the worst time; its time there and the reference's [s].
        fault: What the solver said in place of a solution.
        seconds: CPU time of the solver [s], compilation included.
        doubts: What the solution's own certificate says.
    """

    seed: int
    words: str
    states: int = 0
    reachable: int = 0
    lost: int = 0
    gained: int = 0
    median: float = float("nan")
    worst: float = float("nan")
    at: str = ""
    fault: str = ""
    seconds: float = 0.0
    doubts: tuple[str, ...] = ()

    @property
    def wrong(self) -> bool:
        """Whether a limit is broken."""
        unreachable = self.states - self.reachable
        return bool(
            self.fault or self.lost or self.median > MEDIAN_LIMIT or self.gained > REACHABLE_LIMIT * unreachable
        )


def judge(case: Case, value: Callable[[Array], Array], seed: int, count: int = STATES, seconds: float = 0.0) -> Verdict:
    """Return the judgement of a solution.

    Args:
        case: System with its reference.
        value: Times (N,) [s] of states (N, n) by the solution, +inf for unreachable.
        seed: Seed of the system, from which the states are drawn as well.
        count: Number of states.
        seconds: CPU time that the solution took [s].
    """
    states = draw_states(case.problem, np.random.default_rng([seed, 1]), count)
    exact, found = case.reference(states), value(states)
    known = ~np.isnan(exact)
    differ = known & (np.isfinite(exact) != np.isfinite(found))
    differ[differ] = ~near_boundary(case, states[differ])
    lost, gained = differ & np.isfinite(exact), differ & ~np.isfinite(exact)
    timed = known & np.isfinite(exact) & np.isfinite(found) & ~near_target(case.problem, states)
    errors = np.full(count, -1.0)
    errors[timed] = np.abs(found[timed] - exact[timed]) / exact[timed]
    shown = int(np.argmax(lost if lost.any() else gained if gained.any() else errors))
    return Verdict(
        seed=seed,
        words=case.words,
        states=int(known.sum()),
        reachable=int((known & np.isfinite(exact)).sum()),
        lost=int(lost.sum()),
        gained=int(gained.sum()),
        median=float(np.median(errors[timed])) if timed.any() else float("nan"),
        worst=float(errors.max()) if timed.any() else float("nan"),
        at=f"{np.array2string(states[shown], separator=', ')}: {found[shown]:.6g} s, reference {exact[shown]:.6g} s",
        seconds=seconds,
    )


def draw_states(problem: TimeToReachProblem, random: np.random.Generator, count: int) -> Array:
    """Return states (count, n) from the grid without its edges."""
    edges = [0.0 if axis.periodic else CELLS * axis.spacing for axis in problem.axes]
    low = np.array([axis.lower + edge for axis, edge in zip(problem.axes, edges, strict=True)])
    high = np.array([axis.upper - edge for axis, edge in zip(problem.axes, edges, strict=True)])
    return random.uniform(low, high, (count, len(low)))


def near_boundary(case: Case, states: Array) -> NDArray[np.bool_]:
    """Return (N,) whether the fate of a state, as the reference knows it, changes within two cells of it."""
    fate = _fate(case.reference(states))
    changes = np.zeros(len(states), dtype=bool)
    for shifted in _around(case.problem, states):
        changes |= _fate(case.reference(shifted)) != fate
    return changes


def near_target(problem: TimeToReachProblem, states: Array) -> NDArray[np.bool_]:
    """Return (N,) whether a state lies in the target or within two cells of it."""
    names = problem.system.state_names
    near = problem.target.contains(names, states)
    for shifted in _around(problem, states):
        near |= problem.target.contains(names, shifted)
    return near


def _around(problem: TimeToReachProblem, states: Array) -> list[Array]:
    """Return the states moved by up to two cells along the axes, on a lattice, kept on the grid."""
    steps = range(-CELLS, CELLS + 1) if len(problem.axes) <= 2 else (-CELLS, 0, CELLS)
    spacing = np.array([axis.spacing for axis in problem.axes])
    moved = []
    for step in product(steps, repeat=len(problem.axes)):
        shifted = states + np.array(step) * spacing
        for k, axis in enumerate(problem.axes):
            if axis.periodic:
                shifted[:, k] = axis.lower + np.mod(shifted[:, k] - axis.lower, axis.upper - axis.lower)
            else:
                shifted[:, k] = np.clip(shifted[:, k], axis.lower, axis.upper)
        moved.append(shifted)
    return moved


def _fate(times: Array) -> NDArray[np.int_]:
    return np.where(np.isnan(times), 2, np.isfinite(times).astype(int))

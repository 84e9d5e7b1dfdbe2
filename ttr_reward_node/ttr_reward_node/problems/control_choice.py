"""How many samples of each control the solvers try.

Where every derivative is affine in the controls, the bounds are enough: the best control lies at a corner of their box.
Elsewhere it may lie anywhere between. What counts then is the set of velocities f(x, U): the samples must span the same
convex hull, to about a hundredth of its size, at random states of the grid. Hulls are compared by their support
functions, the largest p . f(x, u) along random directions p, with those of thousands of controls.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, System
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.dependence import AFFINE, dependences
from ttr_reward_node.problems.limits import state_limits

Array = NDArray[np.float64]
USUAL_COUNT = 3
"""Samples of a control that enters linearly: the bounds, and the middle, which saves switching to and fro."""
MOST_SAMPLES = 129
"""Controls that are tried at most, unless their number is asked for."""
_ACCURACY = 0.01  # of half of the set's width
_DOUBTFUL = 0.03  # likewise, from where on the samples are said to be too few
_STATES = 64
_DIRECTIONS = 32
_DENSE = (1025, 33, 11, 7)  # samples of each of 1, 2, 3, 4 controls to compare with
_RANDOM = 512  # random controls to compare with
_NARROW = 0.05  # of the largest width along a state's axis: sets that are narrower there are measured by this


def check_control_counts(system: System, counts: int | Sequence[int]) -> None:
    """Refuse numbers of samples that are no numbers from 2 on, one for all controls or one for each.

    Raises:
        TimeToReachError: They are not.
    """
    each = [counts] if isinstance(counts, int) else list(counts)
    wrong = any(isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 2 for count in each)
    if wrong or (not isinstance(counts, int) and len(each) != len(system.controls)):
        names = ", ".join(system.control_names) or "none"
        raise TimeToReachError(
            f"control_counts are {counts}: give a whole number from 2 on, or one for each of the controls: {names}"
        )


def choose_control_counts(hulls: VelocityHulls, asked: Mapping[str, int] | None = None) -> int | tuple[int, ...]:
    """Return how many samples of each control the solvers should try.

    Args:
        hulls: Velocities of the system on its grid.
        asked: Number of samples by control name, where it is not to be chosen.

    Raises:
        TimeToReachError: There is no such control, or a number is below 2.
    """
    asked, system = {} if asked is None else dict(asked), hulls.system
    for name in asked:
        if name not in system.control_names:
            raise TimeToReachError(
                f"{system.name} has no control '{name}'; there are {', '.join(system.control_names) or 'none'}"
            )
    counts = [asked.get(name, USUAL_COUNT) for name in system.control_names]
    check_control_counts(system, counts)
    bent = _bent_controls(system)
    if not bent and not asked:
        return USUAL_COUNT
    free = [k for k in bent if system.control_names[k] not in asked]
    if free:
        while hulls.error(counts) > _ACCURACY:
            finer = [[2 * c - 1 if i == k else c for i, c in enumerate(counts)] for k in free]
            finer = [some for some in finer if hulls.samples(some) <= MOST_SAMPLES]
            if not finer:
                break
            counts = min(finer, key=hulls.error)
    return tuple(counts)


def control_doubt(hulls: VelocityHulls, counts: int | Sequence[int]) -> str:
    """Return what is wrong with the numbers of samples: a line that says what to change, empty where nothing is."""
    system = hulls.system
    bent = _bent_controls(system)
    error = hulls.error(counts) if bent else 0.0
    if error <= _DOUBTFUL:
        return ""
    each = [counts] * len(system.controls) if isinstance(counts, int) else list(counts)
    more = " ".join(f"{system.control_names[k]}={2 * each[k] - 1}" for k in bent)
    return (
        f"the samples of the controls miss up to {100 * error:.0f} % of the velocities: solve with more, such as "
        f"--controls {more}"
    )


def sample_controls(hulls: VelocityHulls, counts: int | Sequence[int]) -> Array:
    """Return the controls (k, m) that are tried: as `System.control_samples`, less the end of a whole turn.

    Where a control does the same at both bounds, as a heading does over a whole turn, the upper one is left out.
    """
    if not _bent_controls(hulls.system):
        return hulls.system.control_samples(counts)
    return hulls.controls(counts)


def _bent_controls(system: System) -> list[int]:
    """Return the controls that a derivative is not affine in, as far as the equations tell."""
    rates = [rate for rate in dependences(system) if rate.control_degree > AFFINE]
    return sorted(frozenset[int]().union(*(rate.controls for rate in rates)))


@dataclass(frozen=True, eq=False)
class VelocityHulls:
    """Sets of velocities of a system at random states of a grid, and how well samples of the controls span them."""

    system: System
    axes: Sequence[Axis]

    def controls(self, counts: int | Sequence[int]) -> Array:
        """Return evenly spaced controls (k, m)."""
        each = [counts] * len(self.system.controls) if isinstance(counts, int) else list(counts)
        ticks = [
            np.linspace(c.lower, c.upper, 1 if c.lower == c.upper else count)[: -1 if turns and count > 2 else None]
            for c, count, turns in zip(self.system.controls, each, self._turns, strict=True)
        ]
        return np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, len(each))

    def samples(self, counts: int | Sequence[int]) -> int:
        """Return the number of those controls."""
        return len(self.controls(counts))

    def error(self, counts: int | Sequence[int]) -> float:
        """Return by how much the samples' hull is smaller than the true one, at most, as a part of half its width."""
        support, half = self._reference
        found = self._supports(self.controls(counts))
        return float(np.max((support - found) / half, initial=0.0))

    @cached_property
    def _states(self) -> Array:
        random = np.random.default_rng(1)
        ends = np.array([[axis.lower for axis in self.axes], [axis.upper for axis in self.axes]])
        lower, upper = np.clip(ends, *state_limits(self.system, self.axes))
        return random.uniform(lower, upper, (_STATES, len(self.axes)))

    @cached_property
    def _turns(self) -> list[bool]:
        """Whether each control does the same at both of its bounds."""
        random, (low, high) = np.random.default_rng(2), self.system.control_bounds
        turns = []
        for k in range(len(low)):
            u = random.uniform(low, high, (_STATES, len(low)))
            ends = []
            for bound in (low[k], high[k]):
                u[:, k] = bound
                ends.append(self.system.dynamics(self._states, u))
            same = np.allclose(ends[0], ends[1], rtol=1e-9, atol=1e-9 * float(np.abs(ends).max()))
            turns.append(bool(low[k] < high[k] and same))
        return turns

    @cached_property
    def _dense(self) -> Array:
        """Many controls: a grid that is as fine as a few thousand allow, and random ones."""
        random, (low, high) = np.random.default_rng(3), self.system.control_bounds
        free = int(np.count_nonzero(low < high))
        some = random.uniform(low, high, (_RANDOM, len(low)))
        if free > len(_DENSE):
            return np.concatenate((some, self.system.control_samples(2)))
        return np.concatenate((some, self.system.control_samples(_DENSE[max(free, 1) - 1])))

    @cached_property
    def _directions(self) -> Array:
        """Directions (p, n), each component by the range of that derivative."""
        width = np.zeros(len(self.axes))
        for x in self._states:
            width = np.maximum(width, np.ptp(self._velocities(x, self._dense), axis=0))
        moved = np.flatnonzero(width > 0.0)
        units = np.eye(len(width))[moved]
        random = np.random.default_rng(4).normal(size=(_DIRECTIONS, len(moved)))
        random /= np.linalg.norm(random, axis=1, keepdims=True) + 1e-300
        scaled = np.concatenate((units, -units, random @ units))
        return np.divide(scaled, width, out=np.zeros_like(scaled), where=width > 0.0)

    @cached_property
    def _reference(self) -> tuple[Array, Array]:
        """Support function (states, directions) of many controls, and half of the width of the sets."""
        support, opposite = (self._supports(self._dense, sign) for sign in (1.0, -1.0))
        half = 0.5 * (support + opposite)
        return support, np.maximum(half, 0.5 * _NARROW)

    def _supports(self, controls: Array, sign: float = 1.0) -> Array:
        directions = sign * self._directions
        return np.array([(self._velocities(x, controls) @ directions.T).max(axis=0) for x in self._states])

    def _velocities(self, x: Array, controls: Array) -> Array:
        return np.broadcast_to(self.system.dynamics(x, controls), (len(controls), len(x)))

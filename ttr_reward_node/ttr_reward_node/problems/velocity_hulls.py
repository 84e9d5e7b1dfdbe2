"""Sets of velocities f(x, U) of a system at states of its grid, and how well control samples span them.

Only the convex hull of such a set matters, described by its support function: the largest p . f(x, u) along a direction
p. A front of equal times with normal p moves at that speed. So the error of the samples is measured in two ways:
relative to half the width of the set, and relative to the speed of the front. Against a current nearly as fast as the
boat, the second is many times the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, System
from ttr_reward_node.problems.limits import state_limits

Array = NDArray[np.float64]

_STATES = 64
_DIRECTIONS = 32  # number of random directions per state, and again of directions against its mean velocity
_CONE = 0.5  # spread of the directions against the mean velocity
_DENSE = (1025, 33, 11, 7)  # reference samples per control for 1, 2, 3 and 4 controls
_RANDOM = 512  # number of random reference controls
_HALVINGS = 12  # halvings of the sample distance in the search for the best control along each direction
_NARROW = 0.05  # minimum width of a set as a reference, relative to the largest along the state's axis
_CREEP = 0.05  # minimum speed of a front as a reference, relative to half the width


class Supports(NamedTuple):
    """Support functions of the sets.

    Attributes:
        largest: Largest p . f(x, u) over the controls (states, directions); a direction p has the unit 1 / f.
        controls: Maximising controls (states, directions, m).
        half: Half of the set's width (states, directions).
    """

    largest: Array
    controls: Array
    half: Array


@dataclass(frozen=True, eq=False)
class VelocityHulls:
    """Sets of velocities at random states of a grid."""

    system: System
    axes: Sequence[Axis]

    def controls(self, counts: int | Sequence[int]) -> Array:
        """Return evenly spaced controls (k, m), without the duplicate end of a full turn."""
        each = [counts] * len(self.system.controls) if isinstance(counts, int) else list(counts)
        ticks = [
            np.linspace(c.lower, c.upper, 1 if c.lower == c.upper else count)[: -1 if turns and count > 2 else None]
            for c, count, turns in zip(self.system.controls, each, self._turns, strict=True)
        ]
        return np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, len(each))

    def samples(self, counts: int | Sequence[int]) -> int:
        """Return the number of controls that `controls` returns."""
        return len(self.controls(counts))

    def missing_width(self, controls: Array) -> float:
        """Return the largest deficit of the hull of controls (k, m), relative to half the width of the true hull."""
        missing = self._true.largest - self._supports(controls)
        return float(np.max(missing / self._true.half, initial=0.0))

    def missing_speed(self, controls: Array) -> float:
        """Return the largest speed deficit of controls (k, m), relative to the speed of a front."""
        return float(np.max((self._true.largest - self._supports(controls)) / self._speeds, initial=0.0))

    def complete(self, controls: Array, accuracy: float, most: int) -> Array:
        """Return controls to add to `controls`, until no front is slower by more than a given fraction.

        Each added control is the best one in the direction with the largest deficit so far.

        Args:
            controls: Existing controls (k, m).
            accuracy: Tolerated deficit as a fraction of a front's speed.
            most: Maximum total number of controls.
        """
        found = self._supports(controls)
        more: list[Array] = []
        while len(controls) + len(more) < most:
            missing = (self._true.largest - found) / self._speeds
            worst = np.unravel_index(int(np.argmax(missing)), missing.shape)
            if missing[worst] <= accuracy:
                break
            more.append(self._true.controls[worst])
            found = np.maximum(found, self._supports(more[-1][None]))
        return np.reshape(more, (len(more), controls.shape[1]))

    @cached_property
    def _states(self) -> Array:
        random = np.random.default_rng(1)
        ends = np.array([[axis.lower for axis in self.axes], [axis.upper for axis in self.axes]])
        lower, upper = np.clip(ends, *state_limits(self.system, self.axes))
        return random.uniform(lower, upper, (_STATES, len(self.axes)))

    @cached_property
    def _turns(self) -> list[bool]:
        """Whether each control has the same effect at both of its bounds."""
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
        """Reference controls: a grid of a few thousand at most, and random ones."""
        random, (low, high) = np.random.default_rng(3), self.system.control_bounds
        free = int(np.count_nonzero(low < high))
        some = random.uniform(low, high, (_RANDOM, len(low)))
        if free > len(_DENSE):
            return np.concatenate((some, self.system.control_samples(2)))
        return np.concatenate((some, self.system.control_samples(_DENSE[max(free, 1) - 1])))

    @cached_property
    def _directions(self) -> Array:
        """Directions (states, directions, n), each component scaled by the range of that derivative."""
        velocities = [self._velocities(x, self._dense) for x in self._states]
        width = np.max([np.ptp(each, axis=0) for each in velocities], axis=0)
        moved = np.flatnonzero(width > 0.0)
        units = np.tile(np.eye(len(moved)), (len(self._states), 1, 1))
        against = np.array([-each.mean(axis=0)[moved] / width[moved] for each in velocities])[:, None]
        against /= np.linalg.norm(against, axis=-1, keepdims=True) + 1e-300
        random = np.random.default_rng(4).normal(size=(2, len(self._states), _DIRECTIONS, len(moved)))
        cone = against + _CONE * random[1] / max(len(moved), 1) ** 0.5
        found = np.concatenate((units, -units, against, random[0], cone), axis=1)
        found /= np.linalg.norm(found, axis=-1, keepdims=True) + 1e-300
        out = np.zeros((*found.shape[:2], len(width)))
        out[..., moved] = found / width[moved]
        return out

    @cached_property
    def _true(self) -> Supports:
        largest, controls = self._best(1.0)
        half = 0.5 * (largest + self._best(-1.0)[0])
        return Supports(largest, controls, np.maximum(half, 0.5 * _NARROW))

    @cached_property
    def _speeds(self) -> Array:
        """Reference speeds of fronts; half of the width if no control moves along the direction."""
        largest, _, half = self._true
        return np.where(largest > 0.0, np.clip(largest, _CREEP * half, half), half)

    def _best(self, sign: float) -> tuple[Array, Array]:
        """Return the largest sign * p . f(x, u) (states, directions), and its controls (states, directions, m)."""
        directions, (low, high) = sign * self._directions, self.system.control_bounds
        found = [self._velocities(x, self._dense) @ p.T for x, p in zip(self._states, directions, strict=True)]
        largest = np.array([each.max(axis=0) for each in found])
        controls = np.array([self._dense[each.argmax(axis=0)] for each in found])
        free = np.flatnonzero(low < high)
        reach = np.zeros(len(low))
        reach[free] = (high - low)[free] / (_DENSE[min(len(free), len(_DENSE)) - 1] - 1) if len(free) else 0.0
        for halving in range(_HALVINGS):
            for k in free:
                for way in (-1.0, 1.0):
                    tried = controls.copy()
                    tried[..., k] = np.clip(tried[..., k] + way * reach[k] * 0.5**halving, low[k], high[k])
                    value = (self.system.dynamics(self._states[:, None], tried) * directions).sum(axis=-1)
                    better = value > largest
                    largest, controls = np.where(better, value, largest), np.where(better[..., None], tried, controls)
        return largest, controls

    def _supports(self, controls: Array) -> Array:
        """Return the largest p . f(x, u) of controls (k, m), shape (states, directions)."""
        pairs = zip(self._states, self._directions, strict=True)
        return np.array([(self._velocities(x, controls) @ p.T).max(axis=0) for x, p in pairs])

    def _velocities(self, x: Array, controls: Array) -> Array:
        return np.broadcast_to(self.system.dynamics(x, controls), (len(controls), len(x)))

"""Sets of states: start, goal and trap regions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.geometry.shapes import Disc
from ctrl_rl_core.geometry.units import Interval

ANGLES = frozenset({"theta", "phi", "psi", "heading"})
"""Angular state components: an interval also matches equivalent angles."""


@dataclass(frozen=True)
class Region:
    """Intervals of some state components, and optionally a disc of positions; other components are unconstrained.

    Attributes:
        intervals: Intervals by state name, in SI units.
        disc: Disc of positions [m]; None if unconstrained.
    """

    intervals: Mapping[str, Interval] = field(default_factory=dict)
    disc: Disc | None = None

    def contains(self, names: Sequence[str], states: ArrayLike) -> NDArray[np.bool_]:
        """Return which states lie in the region (...).

        Args:
            names: Components of a state; the first two positions (x, y or x, z) are used for the disc.
            states: States (..., n) in SI units.

        Raises:
            KeyError: The region constrains a component missing from `names`.
        """
        states = np.asarray(states, dtype=float)
        inside = np.ones(states.shape[:-1], dtype=bool)
        for name, interval in self.intervals.items():
            if name not in names:
                raise KeyError(f"the region bounds '{name}', but the state has only {', '.join(names)}")
            values = states[..., list(names).index(name)]
            if name in ANGLES:
                values = interval.centre + wrap(values - interval.centre)
            inside &= (values >= interval.low) & (values <= interval.high)
        if self.disc is not None:
            inside &= self.disc.signed_distance(states[..., position_indices(names)]) <= 0.0
        return inside

    def make_test(self, names: Sequence[str]) -> Callable[[Sequence[float]], bool]:
        """Return a fast test whether one state (n,) of plain floats lies in the region.

        Args:
            names: Components of a state, as for `contains`.

        Raises:
            KeyError: The region constrains a component missing from `names`.
        """
        self.contains(names, np.zeros(len(names)))  # raises for unknown components
        bounds = [(list(names).index(name), name in ANGLES, *each) for name, each in self.intervals.items()]
        first, second = position_indices(names) if self.disc is not None else (0, 0)

        def test(state: Sequence[float]) -> bool:
            for index, turns, low, high in bounds:
                value = state[index]
                if turns:
                    centre = 0.5 * (low + high)
                    value = centre + wrap_one(value - centre)
                if not low <= value <= high:
                    return False
            if self.disc is None:
                return True
            (x, y), radius = self.disc.centre, self.disc.radius
            return math.hypot(state[first] - x, state[second] - y) <= radius

        return test

    def sample(self, names: Sequence[str], random: np.random.Generator) -> NDArray[np.float64]:
        """Draw one state (n,) uniformly from intervals and disc; unconstrained components are 0."""
        state = np.array([random.uniform(*self.intervals.get(name, Interval(0.0, 0.0))) for name in names])
        if self.disc is not None:
            radius, angle = self.disc.radius * np.sqrt(random.uniform()), random.uniform(-np.pi, np.pi)
            state[position_indices(names)] = np.add(self.disc.centre, (radius * np.cos(angle), radius * np.sin(angle)))
        return state

    @property
    def position(self) -> tuple[float, float]:
        """Centre of the region's positions [m]."""
        if self.disc is not None:
            return self.disc.centre
        middles = [self.intervals[name].centre for name in ("x", "y", "z") if name in self.intervals]
        return (middles[0], middles[1])


def position_indices(names: Sequence[str]) -> list[int]:
    """Return the indices of the two position components: x and y, or x and z."""
    return [index for index, name in enumerate(names) if name in ("x", "y", "z")][:2]


def wrap(angle: ArrayLike) -> NDArray[np.float64]:
    """Wrap angles to [-pi, pi)."""
    return (np.asarray(angle, dtype=float) + np.pi) % (2.0 * np.pi) - np.pi


def wrap_one(angle: float) -> float:
    """Wrap one angle to [-pi, pi), quickly."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi

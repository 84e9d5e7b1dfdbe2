"""Linear parts z' = A z + b u + c of two states with a convex target, by the supports of what they can reach.

After t seconds such a part can be anywhere in a convex set R(t). It meets the target K if no direction p parts the two,
that is  min over R(t) of p z  <=  max over K of p z  for all p. The first time at which that holds for all parts of a
system at once is found on fine steps of time, and between them by linear interpolation of the gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from scipy.linalg import expm

from ctrl_rl_core import Disc, Interval
from referee.case import Array

DIRECTIONS = 240


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a system.

    Attributes:
        matrix: A, shape (2, 2).
        column: b (2,).
        constant: c (2,).
        low: Least u.
        high: Largest u.
        target: A box, or a disc that is one in the coordinates z / scale.
        scale: Sizes (2,) of the states, which say how directions are spread.
    """

    matrix: Array
    column: Array
    constant: Array
    low: float
    high: float
    target: tuple[Interval, Interval] | Disc
    scale: Array

    def directions(self) -> Array:
        """Return the directions p (DIRECTIONS, 2)."""
        angles = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
        return np.stack((np.cos(angles), np.sin(angles)), axis=1) / self.scale

    def target_support(self, directions: Array) -> Array:
        """Return the largest p z (DIRECTIONS,) in the target."""
        if isinstance(self.target, Disc):
            return directions @ np.array(self.target.centre) + self.target.radius * np.hypot(*directions.T)
        corners = np.array([(a, b) for a in self.target[0] for b in self.target[1]])
        return (directions @ corners.T).max(axis=1)

    def tables(self, step: float, count: int) -> tuple[Array, Array]:
        """Return p e^(A t) (count, DIRECTIONS, 2), and the target's support less the input's part of the least p z."""
        directions = self.directions()
        fine = 2
        small = expm(self.matrix * step / fine)
        turned, moved, added = directions.copy(), [directions], [np.zeros(len(directions))]
        total = np.zeros(len(directions))
        before = self._least_rate(turned)
        for _ in range(1, count):
            for _ in range(fine):  # d/dt of p e^(A t) is that times A: the row vector is turned on the right
                turned = turned @ small
                now = self._least_rate(turned)
                total = total + 0.5 * step / fine * (before + now)
                before = now
            moved.append(turned)
            added.append(total)
        return np.array(moved), self.target_support(directions) - np.array(added)

    def _least_rate(self, turned: Array) -> Array:
        along = turned @ self.column
        return turned @ self.constant + np.minimum(along * self.low, along * self.high)


class Meeting:
    """The first times at which all parts meet their targets at once.

    Attributes:
        parts: Parts of the system.
        step: Step of time [s].
        horizon: Time after which nothing is known [s].
    """

    def __init__(self, parts: Sequence[Part], step: float, horizon: float) -> None:
        self.parts, self.step, self.horizon = tuple(parts), step, horizon

    def times(self, states: Sequence[Array]) -> Array:
        """Return times (N,) [s] from the parts' states (N, 2) each; NaN where it takes longer than the horizon."""
        times = np.empty(len(states[0]))
        _first(*self._tables, np.ascontiguousarray(np.stack(states, axis=1)), self.step, times)
        return times

    @cached_property
    def _tables(self) -> tuple[Array, Array]:
        tables = [part.tables(self.step, int(np.ceil(self.horizon / self.step)) + 1) for part in self.parts]
        return np.array([moved for moved, _ in tables]), np.array([room for _, room in tables])


@njit
def _first(moved: Array, room: Array, states: Array, step: float, times: Array) -> None:  # pragma: no cover
    parts, count, directions = room.shape
    for i in range(len(states)):
        times[i] = np.nan
        last, part = 0, 0  # the direction that parted the two at the last step most likely still does
        for t in range(count):
            if _margin(moved, room, states, i, part, t, last) < 0.0:
                continue
            apart = False
            for k in range(parts):
                for p in range(directions):
                    if _margin(moved, room, states, i, k, t, p) < 0.0:
                        apart, part, last = True, k, p
                        break
                if apart:
                    break
            if not apart:
                times[i] = 0.0 if t == 0 else step * (t - 1 + _share(moved, room, states, i, t))
                break


@njit
def _margin(moved: Array, room: Array, states: Array, i: int, k: int, t: int, p: int) -> float:  # pragma: no cover
    return room[k, t, p] - moved[k, t, p, 0] * states[i, k, 0] - moved[k, t, p, 1] * states[i, k, 1]


@njit
def _share(moved: Array, room: Array, states: Array, i: int, t: int) -> float:  # pragma: no cover
    """Return the part of the last step after which the last direction stops parting the two."""
    share = 0.0
    for k in range(room.shape[0]):
        for p in range(room.shape[2]):
            before = _margin(moved, room, states, i, k, t - 1, p)
            if before < 0.0:
                share = max(share, before / (before - _margin(moved, room, states, i, k, t, p)))
    return share

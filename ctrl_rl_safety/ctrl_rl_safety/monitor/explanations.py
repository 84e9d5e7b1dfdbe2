"""Select the smallest growth of bounds that covers an open hypothesis, i.e. one that is not refuted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.bool_]

_BESIDE = 0.1
"""Delays up to this much longer than the shortest explaining one are accepted as well [s], since a late start does not
distinguish a long delay from a slightly shorter one with less acceleration."""


class Grown(NamedTuple):
    """Indices of intervals, ordered from the model's value to worse values.

    Attributes:
        delay: Interval of the delay.
        build: Interval of the rate away from zero.
        shed: Interval of the rate towards zero.
    """

    delay: int
    build: int
    shed: int

    def beside(self, other: Grown) -> Grown:
        """Return the worse of both in each respect."""
        return Grown(*(max(a, b) for a, b in zip(self, other, strict=True)))


def explained(open_: Flags, known: Grown, delays: NDArray[np.float64], both: bool) -> Grown:
    """Return the least growth of bounds that covers some hypothesis.

    Args:
        open_: Whether each hypothesis is open (delays, building rates, shedding rates); at least one is.
        known: Bounds so far.
        delays: Longest delay of each interval, beyond the stated one (delays,) [s].
        both: Whether to assume both a longer delay and a lower shedding rate if each alone explains the motion, until a
            measurement decides between them; otherwise only the delay.
    """
    if open_[: known.delay + 1, : known.build + 1, : known.shed + 1].any():
        return known
    builds = np.flatnonzero(open_.any(axis=(0, 2)))
    build = max(known.build, int(builds[0]))
    left = np.asarray(open_[:, : build + 1].any(axis=1))
    if left[: known.delay + 1, : known.shed + 1].any():
        return known._replace(build=build)
    late = np.flatnonzero(left[:, : known.shed + 1].any(axis=1))
    weak = np.flatnonzero(left[: known.delay + 1].any(axis=0))
    delay, shed = known.delay, known.shed
    if len(late):
        beside = late[delays[late] <= delays[late[0]] + _BESIDE + 1e-9]
        delay = max(delay, int(beside[-1]))
    if len(weak) and (both or not len(late)):
        shed = max(shed, int(weak[0]))
    if not len(late) and not len(weak):
        at, which = np.nonzero(left)
        best = int(np.argmin(at + which))
        delay, shed = max(delay, int(at[best])), max(shed, int(which[best]))
    return Grown(delay, build, shed)

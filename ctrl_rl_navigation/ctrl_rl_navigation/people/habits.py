"""What people are likely to do next, from what was seen of people at the same place before.

Most who walk about a place repeat themselves: they turn round at the same ends, and stand there for as long as the last
time. So the last seconds of a mover are compared with all that was seen before. Each passage that was alike is a
prediction, which follows what came after it: a chain of pieces at constant velocity, each of which holds for some time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_navigation.people.movers import COLUMNS, mover

Array = NDArray[np.float64]

_STEP = 0.2
"""Interval between remembered places [s]."""
_MEMORY = 400
"""Number of places that are remembered of a walk at least."""
_BACK = np.array((2, 4, 8, 16))
"""Steps back from a moment to the places by which it is compared with another."""
_LEAST = 8
"""Number of steps that must be known at least."""
_PLACE = 0.35
"""Distance up to which moments are alike [m]."""
_COVERED, _SHARE = 0.2, 0.15
"""Difference of what was covered since an earlier place up to which moments are alike: fixed [m], and share of it."""
_AWAY = 0.5
"""Distance that somebody must have been away for a place to be visited again [m]."""
_APART = 5
"""Steps between two moments that belong to different passages."""
_PASSAGES = 3
"""Maximum number of passages that are followed, the latest ones."""
_PIECE, _PIECES = 2, 18
"""Steps of a piece, and number of pieces of a prediction."""
_UNLIKE = 0.5
"""Number of passages as which the possibility counts that this one is unlike all before."""
_PLACE_ERROR, _VELOCITY_ERROR = 0.06, 0.04
"""Standard deviations of the place and the velocity of a repeated passage [m], [m/s]."""


class Walk:
    """Places of one mover in equal steps of time.

    Attributes:
        end: Time of the last place [s].
    """

    def __init__(self) -> None:
        self._buffer, self._count, self.end = np.empty((2 * _MEMORY, 2)), 0, -math.inf

    @property
    def places(self) -> Array:
        """Places (n, 2) [m]."""
        return self._buffer[: self._count]

    def note(self, now: float, place: Array) -> None:
        """Note a place (2,) [m] at a time [s]; those between the last one and this are interpolated."""
        if not self._count:
            self.end = now
            self._append(place)
            return
        last, passed = self.places[-1].copy(), now - self.end
        for k in range(1, math.floor(passed / _STEP + 1e-6) + 1):
            self._append(last + (place - last) * min(k * _STEP / passed, 1.0))
            self.end += _STEP

    def _append(self, place: Array) -> None:
        if self._count == len(self._buffer):
            self._buffer[:_MEMORY], self._count = self._buffer[_MEMORY:], _MEMORY
        self._buffer[self._count] = place
        self._count += 1

    @property
    def went_away(self) -> bool:
        """Whether there is more to it than standing about."""
        return self._count > _LEAST and bool(np.hypot(*np.ptp(self.places, axis=0)) > _AWAY)


class _Passage(NamedTuple):
    """A moment that was like the present one: mean square difference [m^2], and displacements after it (n, 2) [m]."""

    mismatch: float
    after: Array


def expected(walk: Walk, others: Iterable[Walk], now: float, radius: float) -> tuple[float, Array]:
    """Return the predictions by passages like the present one, and the probability that they say nothing of it.

    Args:
        walk: Places of a mover so far.
        others: Places of all others, now or before.
        now: Time at which predictions begin [s].
        radius: Radius of the mover [m].

    Returns:
        That probability, and predictions (n, 12), see `movers`.
    """
    own = walk.places
    if len(own) <= _LEAST:
        return 1.0, np.empty((0, COLUMNS))
    away = np.flatnonzero(((own - own[-1]) ** 2).sum(axis=1) > _AWAY**2)
    passages = _passages(own, own, int(away[-1]) if len(away) else 0)
    for other in others:
        if len(passages) >= _PASSAGES:
            break
        passages += _passages(own, other.places, len(other.places))
    passages = passages[:_PASSAGES]
    each = 1.0 / (len(passages) + _UNLIKE)
    chains = [_chain(passage, own[-1], walk.end - now, radius, each) for passage in passages]
    return _UNLIKE * each, np.concatenate((np.empty((0, COLUMNS)), *chains))


def _passages(own: Array, places: Array, until: int) -> list[_Passage]:
    """Return passages in a walk (n, 2) up to some index that were like the end of one's own (m, 2), latest first."""
    back = _BACK[len(own) > _BACK]
    first = int(back[-1])
    off = ((places[first : min(until, len(places) - _PIECE)] - own[-1]) ** 2).sum(axis=1)
    near = np.flatnonzero(off < _PLACE**2)
    if not len(near):
        return []
    moments, off = near + first, off[near]
    covered = own[-1] - own[-1 - back]
    change = ((places[moments, None] - places[moments[:, None] - back] - covered) ** 2).sum(axis=2)
    alike = (change < (_COVERED + _SHARE * np.hypot(*covered.T)) ** 2).all(axis=1)
    if not alike.any():
        return []
    moments, mismatch = moments[alike], (off + change.mean(axis=1))[alike]
    out = []
    for run in np.split(np.arange(len(moments)), np.flatnonzero(np.diff(moments) > _APART) + 1):
        best = run[np.argmin(mismatch[run])]
        begin = moments[best]
        out.append(_Passage(float(mismatch[best]), places[begin : begin + _PIECE * _PIECES + 1] - places[begin]))
    return out[::-1]


def _chain(passage: _Passage, place: Array, begin: float, radius: float, probability: float) -> Array:
    """Return a passage as pieces (n, 12), see `movers`, from a place (2,) [m] at a time [s] on."""
    ends = passage.after[::_PIECE]
    seconds, variance = _PIECE * _STEP, _PLACE_ERROR**2 + 0.25 * passage.mismatch
    rows = []
    for k, (before, after) in enumerate(pairwise(ends)):
        at, velocity = begin + k * seconds, (after - before) / seconds
        first, last = k == 0, k == len(ends) - 2
        rows.append(
            mover(
                place + before - at * velocity,
                velocity,
                radius,
                (variance, 0.0, _VELOCITY_ERROR**2),
                probability,
                -math.inf if first else at,
                math.inf if last else at + seconds,
                0.0,
            )
        )
    return np.array(rows).reshape(-1, COLUMNS)

"""Estimate from commands and measurements how late and how slowly one speed follows its commands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_safety.monitor.explanations import Grown, explained
from ctrl_rl_safety.monitor.following import (
    BUILDS_LATE,
    FITS,
    JITTER,
    LEADS,
    SHEDS_LATE,
    Hypotheses,
    advance,
    command_range,
    judge,
)

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

LATER = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0)
"""Edges of the distinguished intervals of the delay beyond the stated one [s]."""
_RELATIVE = 0.02
"""Relative error of a measured speed."""
LARGEST_GAIN = 0.3
"""Maximum fraction by which a speed may exceed its command."""
UNKNOWN = 1e3
"""Magnitude that stands for an unknown command [unit]."""
_BORNE = 0.5
"""Time for which a speed may exceed every command by more than the slack [s]."""
_STAYS = 1.0
"""Time for which grown bounds must have explained the motion to be kept when a measurement is unexplained [s]."""


class Follower:
    """Hypotheses about how one speed follows its commands, and the bounds from those still open.

    Args:
        delay: Stated delay [s].
        lag: Stated lag [s].
        builds: Edges of the intervals of the building rate, in the order in which bounds grow (k + 1,) [unit/s].
        stated: Number of those intervals that the model allows.
        sheds: Edges of the intervals of the shedding rate, from the highest one down (j + 1,) [unit/s].
        error: Error of a measurement near zero [unit].
        slack: Tolerated excess over every command [unit].
        tied: Whether both rates are equal, so that each building interval is paired with the shedding interval of the
            same index.

    Attributes:
        grown: Indices of the bounds that cover the measurements.
        gain: Fraction by which the speed has exceeded its commands.
        excess: Amount by which it has exceeded them [unit].
        delays: Whether each interval of the delay is open after the last measurement.
        lost: Whether the speed returns to zero more slowly than any hypothesis allows.
    """

    def __init__(
        self,
        delay: float,
        lag: float,
        builds: Sequence[tuple[float, float]],
        stated: int,
        sheds: Sequence[tuple[float, float]],
        error: float,
        slack: float,
        tied: bool = False,
    ) -> None:
        shape = len(LATER), 1 if tied else len(builds), len(sheds)
        at, up, down = (each.ravel() for each in np.indices(shape))
        build, shed = np.array(sheds if tied else builds), np.array(sheds)
        longest = delay + np.array(LATER)
        shortest = np.concatenate(((0.0,), longest[:-1]))
        self._those = Hypotheses(at.astype(np.int64), shortest, longest, build[down if tied else up], shed[down], lag)
        self._shape, self._error, self._tied = shape, error, tied
        self._longest = float(longest[-1]) + JITTER
        self._known = Grown(0, 0 if tied else stated - 1, 0)
        self.grown, self.gain, self.excess, self.lost = self._known, 0.0, 0.0, False
        self.delays, self._slack = np.ones(len(LATER), np.bool_), slack
        self._later, self._grown_at = np.array(LATER), 0.0
        self._worst = (at == shape[0] - 1) & (down == shape[2] - 1)
        self._borne_at = math.inf
        self._low, self._high = np.zeros(at.size), np.zeros(at.size)
        self._gone, self._ahead = np.zeros(at.size, np.bool_), np.zeros(at.size, np.bool_)

    def error(self, value: float) -> float:
        """Return the error bound of a measured speed [unit]."""
        return self._error + _RELATIVE * abs(value)

    def begin(self, value: float) -> None:
        """Restart from a measured speed, regardless of earlier measurements."""
        error = self.error(value)
        self._borne_at = math.inf
        self._low[:], self._high[:] = value - error, value + error

    def told(self, sent: Array, time: float) -> tuple[float, float]:
        """Return the range of commands possibly in effect at a time [s] under any hypothesis; `UNKNOWN` if unknown."""
        least, most = command_range(sent, time - self._longest, time)
        return float(least), float(most)

    def _most(self, sent: Array, time: float) -> float:
        return max(abs(each) for each in self.told(sent, time))

    def open(self) -> Flags:
        """Return which hypotheses are still open (delays, building rates, shedding rates)."""
        return ~(self._gone | self._ahead).reshape(self._shape)

    def measure(
        self,
        sent: Array,
        begin: float,
        end: float,
        value: float,
        coupled: bool,
        crowded: bool,
        delay: int,
        possible: Flags,
    ) -> None:
        """Judge all hypotheses by a measurement.

        Args:
            sent: Time, lowest and highest value of each command, oldest first (k, 3).
            begin: Time of the last measurement [s].
            end: Time of this one [s].
            value: Measured speed [unit].
            coupled: Whether another speed may have used the force in the meantime.
            crowded: Whether another speed takes up the wheels, so that this one may be smaller than any command.
            delay: Interval of the delay that another speed has determined.
            possible: Intervals of the delay that another speed leaves possible (m,).
        """
        told = self._most(sent, end)
        if told >= UNKNOWN or abs(value) - self.error(value) - told <= max(LARGEST_GAIN * told, self._slack):
            self._borne_at = end
        self.lost |= end - self._borne_at >= _BORNE
        falling, rising = advance(
            self._those, self._low, self._high, sent, begin, end, self.gain, coupled, crowded, self._error
        )
        found = judge(self._low, self._high, falling, rising, self._gone, value, self.error(value))
        late = (found == SHEDS_LATE) | (found == BUILDS_LATE)
        if not late.any() and not (found == LEADS).any():
            return
        before, known = self._ahead.copy(), self._known.beside(Grown(delay, 0, 0))
        self._gone |= late
        self._ahead |= found == LEADS
        left = self.open()
        if not left.all():
            self.delays = np.asarray(left.any(axis=(1, 2))) if left.any() else self.delays
        left &= possible[:, None, None]
        if left.any():
            self._grow(self._explained(left, known), end)
            return
        if end - self._grown_at >= _STAYS:
            self._known = self.grown
        # Hypotheses that were once too pessimistic may fit again if the robot has changed.
        again = (before & (found == FITS)).reshape(self._shape) & possible[:, None, None]
        if again.any():
            self._known = self._explained(again, known.beside(self._known))
            self.delays[:] = True
        else:
            self._exceed(sent, end, abs(value) - self.error(value), found[self._worst])
        self._grow(self._known, end)
        self._gone[:], self._ahead[:] = False, False
        self._low[:], self._high[:] = value - self.error(value), value + self.error(value)

    def _exceed(self, sent: Array, time: float, size: float, worst: NDArray[np.int8]) -> None:
        """Judge a speed that no hypothesis explains.

        Args:
            sent: The commands.
            time: Time of the measurement [s].
            size: Magnitude of the speed, minus its error [unit].
            worst: Judgements of the hypotheses with the longest delay and the weakest brakes.
        """
        told = self._most(sent, time)
        if told >= UNKNOWN:
            return
        if size > told:
            self.excess = max(self.excess, size - told)
            self.gain = max(self.gain, min(size / told - 1.0, LARGEST_GAIN) if told > 0.0 else 0.0)
        elif not self._tied and (worst == SHEDS_LATE).any() and not ((worst == FITS) | (worst == LEADS)).any():
            self.lost = True

    def _explained(self, left: Flags, known: Grown) -> Grown:
        # If the model underestimates the turn rate, the robot takes another path, which is not safer.
        return explained(left, known, self._later, both=not self._tied)

    def _grow(self, found: Grown, time: float) -> None:
        if found != self.grown:
            self.grown, self._grown_at = found, time


def intervals(edges: Sequence[float]) -> list[tuple[float, float]]:
    """Return the intervals (low, high) between neighbouring edges, in ascending or descending order."""
    return [(min(pair), max(pair)) for pair in pairwise(edges)]

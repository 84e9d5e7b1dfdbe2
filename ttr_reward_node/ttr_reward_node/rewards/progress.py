"""Rewards for the seconds that a step brings the goal nearer, beside the task's own reward.

`BestProgress` is the form to begin with: phi counts where it falls below its least value of the episode, and nothing is
taken back. An episode then pays at most 300 phi(start), whichever way it goes; thesis Eq. 3.9 pays -phi at each step,
so that on a long way a collision soon costs less than to drive on.

Each kind is told the seconds to the goal at the start and after each step, +inf where there is no way.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ValueFunction
from ttr_reward_node.rewards.rewards import longest_time, value_domain

Array = NDArray[np.float64]

PER_SECOND = 300.0
"""Reward for a second of progress, where a goal pays 1000 and a collision -400.

At 100 a learner keeps away from a narrow gap: the half second that a careful step gains does not pay for the collisions
on the way to it."""


class Pay(Protocol):
    """A kind of pay for progress."""

    def begin(self, seconds: float) -> None:
        """Begin an episode."""

    def step(self, seconds: float, ended: bool) -> float:
        """Return what a step pays, given whether the episode has ended at goal, collision or trap."""


class Progress:
    """Pays each second gained and takes back each second lost; where there is no way, the longest time counts."""

    def __init__(self, longest: float) -> None:
        self._longest, self._last = longest, longest

    def begin(self, seconds: float) -> None:  # noqa: D102 - see Pay
        self._last = min(seconds, self._longest)

    def step(self, seconds: float, ended: bool) -> float:  # noqa: ARG002, D102
        before, self._last = self._last, min(seconds, self._longest)
        return PER_SECOND * (before - self._last)


class BestProgress:
    """Pays each second that the goal comes nearer than ever before in the episode, and takes nothing back.

    A way that crosses a barrier, where the time to reach jumps up, costs nothing, and no circle pays twice: an episode
    pays at most the time to reach of its start.
    """

    def __init__(self, longest: float) -> None:
        self._longest, self._least = longest, longest

    def begin(self, seconds: float) -> None:  # noqa: D102 - see Pay
        self._least = min(seconds, self._longest)

    def step(self, seconds: float, ended: bool) -> float:  # noqa: ARG002, D102
        before, self._least = self._least, min(seconds, self._least)
        return PER_SECOND * (before - self._least)


class Shaping:
    """Potential-based shaping gamma Phi(s') - Phi(s) with Phi = 300 (longest - phi), 0 where an episode ends.

    Ng, Harada and Russell 1999: it changes no optimal policy.
    """

    def __init__(self, longest: float, gamma: float) -> None:
        self._longest, self._gamma, self._last = longest, gamma, 0.0

    def begin(self, seconds: float) -> None:  # noqa: D102 - see Pay
        self._last = self._potential(seconds)

    def step(self, seconds: float, ended: bool) -> float:  # noqa: D102
        before, self._last = self._last, 0.0 if ended else self._potential(seconds)
        return self._gamma * self._last - before

    def _potential(self, seconds: float) -> float:
        return PER_SECOND * (self._longest - min(seconds, self._longest))


class TimeToReach:
    """The time to reach of a task; a state outside its domain is looked up at the nearest one within.

    Attributes:
        longest: Largest finite time [s].
        domain: Least and largest states that are looked up (2, n).
    """

    def __init__(self, value: ValueFunction) -> None:
        self.longest, self.domain = longest_time(value), value_domain(value, value.state_names)
        self._value = value

    def times(self, states: Array) -> Array:
        """Return the times (N,) from states (N, n) to the goal [s]; +inf where there is no way."""
        times = self._value.value(np.clip(states, *self.domain))
        return np.where(np.isnan(times), np.inf, times)

"""What a step pays for the seconds that it brings the goal nearer, beside the task's own reward.

Each kind is told the seconds to the goal at the start and after each step, +inf where there is no way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from ttr_reward_node.rewards.rewards import Reward

from ctrl_rl_benchmarks.ways.potential import Potential
from ctrl_rl_core import Outcome

Array = NDArray[np.float64]

PER_SECOND = 100.0
"""Reward for a second of progress; a goal pays 1000, a collision -400."""


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


class Record:
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
    """Potential-based shaping gamma Phi(s') - Phi(s) with Phi = 100 (longest - phi), 0 where an episode ends.

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


class PotentialReward:
    """Pay for progress beside the task's own rewards, for the robots of a fleet.

    Args:
        potential: Seconds to the goal.
        make: Makes the pay of one robot.
        robots: Number of robots.
    """

    def __init__(self, potential: Potential, make: Callable[[], Pay], robots: int) -> None:
        self._potential, self._pays = potential, [make() for _ in range(robots)]

    def begin(self, robots: Sequence[int], states: Array) -> None:
        """Begin episodes of robots at their states (len(robots), n)."""
        for robot, seconds in zip(robots, self._potential.times(states).tolist(), strict=True):
            self._pays[robot].begin(seconds)

    def pay(self, states: Array, outcomes: NDArray[np.intp], rewards: Array) -> Array:
        """Return what a step pays each robot (N,)."""
        seconds = np.where(outcomes == Outcome.GOAL, 0.0, self._potential.times(states))
        ended = (outcomes != Outcome.RUNNING) & (outcomes != Outcome.TIMEOUT)
        paid = [pay.step(*each) for pay, *each in zip(self._pays, seconds.tolist(), ended.tolist(), strict=True)]
        return rewards + np.array(paid)


class StateReward:
    """A reward of thesis Table 3.3 while an episode goes on; how it ends pays what the task says."""

    def __init__(self, reward: Reward) -> None:
        self._reward = reward

    def begin(self, robots: Sequence[int], states: Array) -> None:
        """Do nothing: a state pays whatever came before."""

    def pay(self, states: Array, outcomes: NDArray[np.intp], rewards: Array) -> Array:
        """Return what a step pays each robot (N,)."""
        return np.where(outcomes == Outcome.RUNNING, self._reward.intermediate(states), rewards)


MakePay = Callable[[float, float], Pay]
PAYS: dict[str, MakePay] = {
    "progress": lambda longest, _: Progress(longest),
    "record": lambda longest, _: Record(longest),
    "shaping": Shaping,
}
"""Kinds of pay by name, each made from the longest time [s] and the discount of a step."""

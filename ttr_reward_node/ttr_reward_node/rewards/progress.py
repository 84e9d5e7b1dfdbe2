"""Rewards for the seconds that a step brings the goal nearer, paid beside the task's own reward.

`best_progress` is the default everywhere: phi counts where it falls below its minimum of the episode, and nothing is
taken back. An episode then pays at most `per_second` phi(start), whichever way it goes; thesis Eq. 3.9 pays -phi at
each step, so that on a long way a collision soon costs less than to drive on.

Every kind is told the seconds to the goal at the start and after each step, +inf where there is no way. All work on
arrays (N,), one element for each of N robots, and on single numbers alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import Outcome, ValueFunction, ValueFunctionError
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.rewards.rewards import (
    KIND,
    EvaluatedReward,
    RewardEvaluator,
    check_informative,
    longest_time,
    value_domain,
)

Array = NDArray[np.float64]

PER_SECOND = 300.0
"""Reward for a second of progress in the suite's tasks, where a goal pays 1000 and a collision -400.

At 100 a learner keeps away from a narrow gap: the half second that a careful step gains does not pay for the collisions
on the way to it."""


class Pay(Protocol):
    """A kind of pay for progress."""

    def begin(self, seconds: ArrayLike, which: ArrayLike = True) -> None:
        """Begin episodes at times to reach (N,) [s], of those robots only for which `which` (N,) is true."""

    def step(self, seconds: ArrayLike, ended: ArrayLike) -> Array:
        """Return what a step pays (N,).

        Args:
            seconds: Times to reach after the step (N,) [s].
            ended: Whether the episode has ended at goal, collision or trap (N,); not by its time limit.
        """


class Progress:
    """Pays each second gained and takes back each second lost; where there is no way, the longest time counts."""

    def __init__(self, longest: float, per_second: float = PER_SECOND) -> None:
        self._longest, self._per_second, self._last = longest, per_second, np.asarray(longest)

    def begin(self, seconds: ArrayLike, which: ArrayLike = True) -> None:  # noqa: D102 - see Pay
        self._last = np.where(which, np.minimum(seconds, self._longest), self._last)

    def step(self, seconds: ArrayLike, ended: ArrayLike) -> Array:  # noqa: ARG002, D102
        before, self._last = self._last, np.minimum(seconds, self._longest)
        return np.asarray(self._per_second * (before - self._last))


class BestProgress:
    """Pays each second that the goal comes nearer than ever before in the episode, and takes nothing back.

    A way that crosses a barrier, where the time to reach jumps up, costs nothing, and no circle pays twice: an episode
    pays at most the time to reach of its start.
    """

    def __init__(self, longest: float, per_second: float = PER_SECOND) -> None:
        self._longest, self._per_second, self._minimum = longest, per_second, np.asarray(longest)

    def begin(self, seconds: ArrayLike, which: ArrayLike = True) -> None:  # noqa: D102 - see Pay
        self._minimum = np.where(which, np.minimum(seconds, self._longest), self._minimum)

    def step(self, seconds: ArrayLike, ended: ArrayLike) -> Array:  # noqa: ARG002, D102
        before, self._minimum = self._minimum, np.minimum(seconds, self._minimum)
        return np.asarray(self._per_second * (before - self._minimum))


class Shaping:
    """Potential-based shaping gamma Phi(s') - Phi(s), Phi = per_second (longest - phi), 0 where an episode ends.

    Ng, Harada and Russell 1999: it changes no optimal policy.
    """

    def __init__(self, longest: float, gamma: float, per_second: float = PER_SECOND) -> None:
        self._longest, self._gamma, self._per_second, self._last = longest, gamma, per_second, np.asarray(0.0)

    def begin(self, seconds: ArrayLike, which: ArrayLike = True) -> None:  # noqa: D102 - see Pay
        self._last = np.where(which, self._potential(seconds), self._last)

    def step(self, seconds: ArrayLike, ended: ArrayLike) -> Array:  # noqa: D102
        before, self._last = self._last, np.where(ended, 0.0, self._potential(seconds))
        return np.asarray(self._gamma * self._last - before)

    def _potential(self, seconds: ArrayLike) -> Array:
        return np.asarray(self._per_second * (self._longest - np.minimum(seconds, self._longest)))


MakePay = Callable[[float, float, float], Pay]
PAYS: Mapping[str, MakePay] = MappingProxyType(
    {
        "best_progress": lambda longest, per_second, _: BestProgress(longest, per_second),
        "progress": lambda longest, per_second, _: Progress(longest, per_second),
        "shaping": lambda longest, per_second, discount: Shaping(longest, discount, per_second),
    }
)
"""Kinds of pay by name, the default first; made from the longest time [s], the reward per second and the discount."""


class Potential(Protocol):
    """Seconds to the goal.

    Attributes:
        longest: Largest finite value [s].
    """

    longest: float

    def times(self, states: Array) -> Array:
        """Return the times (N,) from states (N, n) to the goal [s]; +inf where there is no way."""


class TimeToReach:
    """The time to reach as a reward, for `train` and for the wrapper `TimeToReachReward`.

    A state outside the grid is looked up at the nearest one within: a robot that is faster than the grid goes is paid
    as at the grid's edge. A state from which no way is known (phi = +inf) is no progress.

    >>> import ctrl_rl
    >>> value = ctrl_rl.solve("car_ttr", counts=(41, 41, 24))
    >>> reward = ctrl_rl.TimeToReach(value)
    >>> float(reward.times([[4.0, 3.0, 1.5]])[0]) < float(reward.times([[-4.0, -3.0, 1.5]])[0])
    True

    Args:
        value: Time to reach that `solve` returns.
        kind: A key of `PAYS`: "best_progress", "progress" or "shaping".
        per_second: Reward for a second of progress.
        discount: Discount of a step, which "shaping" needs to know.

    Attributes:
        longest: Largest finite time [s].
        domain: Smallest and largest states that are looked up (2, n).

    Raises:
        TimeToReachError: The kind is unknown, a number is not finite, or nothing outside the goal reaches it.
        ValueFunctionError: The value is no time to reach.
    """

    def __init__(
        self,
        value: ValueFunction,
        kind: str = next(iter(PAYS)),
        *,
        per_second: float = PER_SECOND,
        discount: float = 0.99,
    ) -> None:
        if kind not in PAYS:
            raise TimeToReachError(f"no kind of pay '{kind}': there are {', '.join(PAYS)}")
        if value.kind != KIND:
            raise ValueFunctionError(f"the value function holds '{value.kind}': '{KIND}' is needed here")
        if not (np.isfinite(per_second) and 0.0 <= discount <= 1.0):
            raise TimeToReachError(f"per_second {per_second}, discount {discount}: a finite number, and one of 0 to 1")
        check_informative(value)
        self.kind, self.per_second, self.discount = kind, per_second, discount
        self.longest, self.domain = longest_time(value), value_domain(value, value.state_names)
        self.value = value

    def times(self, states: ArrayLike) -> Array:
        """Return the times (N,) from states (N, n) to the goal [s]; +inf where there is no way."""
        times = self.value.value(np.clip(states, *self.domain))
        return np.where(np.isnan(times), np.inf, times)

    def check_states(self, names: Sequence[str]) -> None:
        """Refuse states of other components than the value's.

        Raises:
            TimeToReachError: They are others.
        """
        if tuple(names) != tuple(self.value.state_names):
            known = ", ".join(self.value.state_names)
            raise TimeToReachError(f"the time to reach is of the states {known}; here they are {', '.join(names)}")

    def pay(self) -> Pay:
        """Return a new pay that has no episode yet."""
        return PAYS[self.kind](self.longest, self.per_second, self.discount)

    def for_robots(self, count: int) -> PotentialReward:
        """Return the reward of a fleet of so many robots."""
        return PotentialReward(self, self.pay(), count)


class PotentialReward:
    """Pays progress beside the task's own rewards, for the robots of a fleet.

    Args:
        potential: Seconds to the goal.
        pay: Pay of all robots.
        robots: Number of robots.
    """

    def __init__(self, potential: Potential, pay: Pay, robots: int) -> None:
        self._potential, self._pay, self._robots = potential, pay, robots

    def begin(self, robots: Sequence[int], states: Array) -> None:
        """Begin episodes of robots at their states (len(robots), n)."""
        seconds, which = np.zeros(self._robots), np.zeros(self._robots, dtype=bool)
        seconds[list(robots)], which[list(robots)] = self._potential.times(states), True
        self._pay.begin(seconds, which)

    def pay(self, states: Array, outcomes: NDArray[np.intp], rewards: Array) -> Array:
        """Return what a step pays each robot (N,).

        Args:
            states: States after the step (N, n).
            outcomes: Outcomes of their episodes, values of `Outcome` (N,).
            rewards: Rewards of the task (N,).
        """
        seconds = np.where(outcomes == Outcome.GOAL, 0.0, self._potential.times(states))
        ended = (outcomes != Outcome.RUNNING) & (outcomes != Outcome.TIMEOUT)
        return np.asarray(rewards + self._pay.step(seconds, ended))


class ProgressEvaluator:
    """Pays one robot's best progress from state to state, beside what the task pays for the end of an episode.

    What a robot is paid in any span of time is the sum of the rewards in it, however many states there are. An episode
    begins with the first state, with the first one that is back to RUNNING, and with `begin`.

    Args:
        evaluate: Evaluator of the task's states.
        reward: Time to reach of the task, of the kind that is paid.
    """

    def __init__(self, evaluate: RewardEvaluator, reward: TimeToReach) -> None:
        self._evaluate, self._reward, self._pay = evaluate, reward, reward.pay()
        self._last: Outcome | None = None

    def begin(self) -> None:
        """Let an episode begin with the next state."""
        self._last = None

    def __call__(self, state: Array, phi: float) -> EvaluatedReward:
        """Return outcome and reward of a state (n,) whose time to reach is phi [s], +inf or NaN."""
        outcome, at_end = self._evaluate(state, phi)
        last, self._last = self._last, outcome
        arrived = outcome is Outcome.GOAL
        seconds = 0.0 if arrived else float(self._reward.times(state[None])[0])
        if last is None or (last is not Outcome.RUNNING and outcome is Outcome.RUNNING):
            self._pay.begin(seconds)
        gained = float(self._pay.step(seconds, outcome is not Outcome.RUNNING))
        return EvaluatedReward(outcome, gained if outcome is Outcome.RUNNING else gained + at_end)

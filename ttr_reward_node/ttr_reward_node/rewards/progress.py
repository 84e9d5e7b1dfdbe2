"""Rewards for progress towards the goal, measured in seconds of time to reach, added to the task's own reward.

`best_progress` is the default everywhere: it pays only when phi falls below its minimum so far in the episode, and
never takes anything back. An episode then pays at most `per_second` phi(start), whatever the path; thesis Eq. 3.9 pays
-phi at each step, so that on a long path a collision soon costs less than driving on.

Every kind receives the seconds to the goal at the start and after each step, +inf if the goal cannot be reached. All
work on arrays (N,), one element for each of N robots, and on single numbers.
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
"""Reward per second of progress in the suite's tasks, where a goal pays 1000 and a collision -400.

At 100, a learner avoids narrow gaps: the half second gained by a careful step does not offset the collisions on the way
to it."""


class Pay(Protocol):
    """Interface of the progress rewards."""

    def begin(self, seconds: ArrayLike, which: ArrayLike = True) -> None:
        """Begin episodes at times to reach (N,) [s], only for the robots for which `which` (N,) is true."""

    def step(self, seconds: ArrayLike, ended: ArrayLike) -> Array:
        """Return the reward of a step (N,).

        Args:
            seconds: Times to reach after the step (N,) [s].
            ended: Whether the episode has ended at a goal, collision or trap (N,), but not by its time limit.
        """


class Progress:
    """Pays each second gained and deducts each second lost; unreachable states count as the longest time."""

    def __init__(self, longest: float, per_second: float = PER_SECOND) -> None:
        self._longest, self._per_second, self._last = longest, per_second, np.asarray(longest)

    def begin(self, seconds: ArrayLike, which: ArrayLike = True) -> None:  # noqa: D102 - see Pay
        self._last = np.where(which, np.minimum(seconds, self._longest), self._last)

    def step(self, seconds: ArrayLike, ended: ArrayLike) -> Array:  # noqa: ARG002, D102
        before, self._last = self._last, np.minimum(seconds, self._longest)
        return np.asarray(self._per_second * (before - self._last))


class BestProgress:
    """Pays each second by which the time to reach falls below its minimum so far in the episode; deducts nothing.

    Crossing a barrier, where the time to reach jumps up, costs nothing, and no loop pays twice: an episode pays at most
    `per_second` times the time to reach of its start.
    """

    def __init__(self, longest: float, per_second: float = PER_SECOND) -> None:
        self._longest, self._per_second, self._minimum = longest, per_second, np.asarray(longest)

    def begin(self, seconds: ArrayLike, which: ArrayLike = True) -> None:  # noqa: D102 - see Pay
        self._minimum = np.where(which, np.minimum(seconds, self._longest), self._minimum)

    def step(self, seconds: ArrayLike, ended: ArrayLike) -> Array:  # noqa: ARG002, D102
        before, self._minimum = self._minimum, np.minimum(seconds, self._minimum)
        return np.asarray(self._per_second * (before - self._minimum))


class Shaping:
    """Potential-based shaping gamma Phi(s') - Phi(s), Phi = per_second (longest - phi), and 0 when an episode ends.

    It preserves the optimal policy (Ng, Harada and Russell 1999).
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
"""Progress rewards by name, the default first; constructed from the longest time [s], the reward per second and the
discount."""


class Potential(Protocol):
    """Seconds to the goal as a function of the state.

    Attributes:
        longest: Largest finite value [s].
    """

    longest: float

    def times(self, states: Array) -> Array:
        """Return the times (N,) from states (N, n) to the goal [s]; +inf if it cannot be reached."""


class TimeToReach:
    """Time to reach as a reward, for `train` and the wrapper `TimeToReachReward`.

    A state outside the grid, e.g. of a robot faster than the grid's limit, gets the value of the nearest state on it. A
    state that cannot reach the goal (phi = +inf) counts as no progress.

    >>> import ctrl_rl
    >>> value = ctrl_rl.solve("car_ttr", counts=(41, 41, 24))
    >>> reward = ctrl_rl.TimeToReach(value)
    >>> float(reward.times([[4.0, 3.0, 1.5]])[0]) < float(reward.times([[-4.0, -3.0, 1.5]])[0])
    True

    Args:
        value: Time-to-reach function, as returned by `solve`.
        kind: A key of `PAYS`: "best_progress", "progress" or "shaping".
        per_second: Reward per second of progress.
        discount: Discount factor per step, used by "shaping".

    Attributes:
        longest: Largest finite time [s].
        domain: Lower and upper bounds of the states looked up (2, n).

    Raises:
        TimeToReachError: The kind is unknown, a number is not finite, or no state outside the goal can reach it.
        ValueFunctionError: The value is not a time to reach.
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
        """Return the times (N,) from states (N, n) to the goal [s]; +inf if it cannot be reached."""
        times = self.value.value(np.clip(states, *self.domain))
        return np.where(np.isnan(times), np.inf, times)

    def check_states(self, names: Sequence[str]) -> None:
        """Check that the state components are those of the value.

        Raises:
            TimeToReachError: The components differ.
        """
        if tuple(names) != tuple(self.value.state_names):
            known = ", ".join(self.value.state_names)
            raise TimeToReachError(f"the time to reach is of the states {known}; here they are {', '.join(names)}")

    def pay(self) -> Pay:
        """Return a new progress reward without an episode."""
        return PAYS[self.kind](self.longest, self.per_second, self.discount)

    def for_robots(self, count: int) -> PotentialReward:
        """Return the reward for a fleet of `count` robots."""
        return PotentialReward(self, self.pay(), count)


class PotentialReward:
    """Adds progress rewards to the task's own rewards, for the robots of a fleet.

    Args:
        potential: Seconds to the goal.
        pay: Progress reward of all robots.
        robots: Number of robots.
    """

    def __init__(self, potential: Potential, pay: Pay, robots: int) -> None:
        self._potential, self._pay, self._robots = potential, pay, robots

    def begin(self, robots: Sequence[int], states: Array) -> None:
        """Begin episodes of robots at the states (len(robots), n)."""
        seconds, which = np.zeros(self._robots), np.zeros(self._robots, dtype=bool)
        seconds[list(robots)], which[list(robots)] = self._potential.times(states), True
        self._pay.begin(seconds, which)

    def pay(self, states: Array, outcomes: NDArray[np.intp], rewards: Array) -> Array:
        """Return the reward of a step for each robot (N,).

        Args:
            states: States after the step (N, n).
            outcomes: Outcomes of the episodes, values of `Outcome` (N,).
            rewards: Rewards of the task (N,).
        """
        seconds = np.where(outcomes == Outcome.GOAL, 0.0, self._potential.times(states))
        ended = (outcomes != Outcome.RUNNING) & (outcomes != Outcome.TIMEOUT)
        return np.asarray(rewards + self._pay.step(seconds, ended))


class ProgressEvaluator:
    """Pays one robot's best progress from state to state, and the task's reward at the end of an episode.

    The rewards in any time span sum to the progress in it, however many states there are. An episode begins with the
    first state, with the first state that is RUNNING again, and after a call to `begin`.

    Args:
        evaluate: Evaluator of the task's states.
        reward: Time to reach of the task, with the kind of progress reward.
    """

    def __init__(self, evaluate: RewardEvaluator, reward: TimeToReach) -> None:
        self._evaluate, self._reward, self._pay = evaluate, reward, reward.pay()
        self._last: Outcome | None = None

    def begin(self) -> None:
        """Begin an episode at the next state."""
        self._last = None

    def __call__(self, state: Array, phi: float) -> EvaluatedReward:
        """Return outcome and reward of a state (n,) with time to reach phi [s], which may be +inf or NaN."""
        outcome, at_end = self._evaluate(state, phi)
        last, self._last = self._last, outcome
        arrived = outcome is Outcome.GOAL
        seconds = 0.0 if arrived else float(self._reward.times(state[None])[0])
        if last is None or (last is not Outcome.RUNNING and outcome is Outcome.RUNNING):
            self._pay.begin(seconds)
        gained = float(self._pay.step(seconds, outcome is not Outcome.RUNNING))
        return EvaluatedReward(outcome, gained if outcome is Outcome.RUNNING else gained + at_end)

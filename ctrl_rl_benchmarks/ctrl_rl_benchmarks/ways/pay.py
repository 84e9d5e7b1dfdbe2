"""What a step pays for the seconds that it brings the goal nearer, beside the task's own reward.

Each kind is told the seconds to the goal at the start and after each step, +inf where there is no way.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import gymnasium
import numpy as np
from ctrl_rl_training.sb3.environment import Environment, Vector

from ctrl_rl_benchmarks.ways.potential import Potential
from ctrl_rl_core import Outcome

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


class PayWrapper(gymnasium.Wrapper[Vector, Vector, Vector, Vector]):
    """Adds pay for progress to the task's own reward.

    Args:
        environment: Environment of a task.
        potential: Seconds to the goal.
        pay: Kind of the pay.
    """

    def __init__(self, environment: Environment, potential: Potential, pay: Pay) -> None:
        super().__init__(environment)
        self._potential, self._pay = potential, pay

    def reset(self, **options: Any) -> tuple[Vector, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(**options)
        self._pay.begin(_number(self._potential(info["state"])))
        return observation, info

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Hold an action for the task's time step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        seconds = 0.0 if info["outcome"] == Outcome.GOAL.name else _number(self._potential(info["state"]))
        return observation, float(reward) + self._pay.step(seconds, terminated), terminated, truncated, info


def _number(seconds: float) -> float:
    """Return a time, +inf where it is not known."""
    return np.inf if np.isnan(seconds) else seconds


MakePay = Callable[[float, float], Pay]
PAYS: dict[str, MakePay] = {
    "progress": lambda longest, _: Progress(longest),
    "record": lambda longest, _: Record(longest),
    "shaping": Shaping,
}
"""Kinds of pay by name, each made from the longest time [s] and the discount of a step."""

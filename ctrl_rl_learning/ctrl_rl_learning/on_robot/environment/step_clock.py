"""The clock of an environment's steps: when each one is due, how long it took, and what was missed. Pure logic."""

from __future__ import annotations

from typing import NamedTuple

from ctrl_rl_learning.errors import LearningError

_ROUNDING_S = 1e-6


class StepTiming(NamedTuple):
    """The time that a step took.

    Attributes:
        duration: Time from the step's begin to its end [s].
        late: Time by which it ended after it was due [s].
        missed: Number of whole steps that passed without a decision.
    """

    duration: float
    late: float
    missed: int


class StepClock:
    """Steps of equal length on the robot's clock.

    A step that ends a little late leaves the next one less time, so that steps do not drift. After a missed step the
    next one begins anew: what was lost is not made up by short steps.

    Attributes:
        period: Length of a step [s].
        due: Time at which the present step ends [s].
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self._begun = 0.0
        self.due = period

    def begin(self, now: float) -> None:
        """Begin the first step of an episode at a time [s]."""
        self._begun, self.due = now, now + self.period

    def end(self, now: float) -> StepTiming:
        """End the present step at a time [s] and begin the next one.

        Raises:
            LearningError: The clock was set back.
        """
        duration = now - self._begun
        if duration < 0.0:
            raise LearningError(f"the clock went back by {-duration:.3f} s: was the simulator started anew?")
        late = max(now - self.due, 0.0)
        missed = int((late + _ROUNDING_S) / self.period)
        self.due = now + self.period if missed else self.due + self.period
        self._begun = now
        return StepTiming(duration, late, missed)

"""The joint steps of one coordinator: its decisions and the reward between them (thesis Definition 1)."""

from __future__ import annotations

import math

from option_coordinator.options.decision import PolicyQuery
from option_coordinator.policies.joint_policy import JointOptions
from option_coordinator.protocol.clock_reading import ClockReading
from option_coordinator.protocol.protocol_types import JointStep


class Journal:
    """Numbers the decisions, and adds up the reward between them.

    Args:
        now: Time at which it begins [s].
        time_step: Duration of a low-level step [s].
        discount: Discount factor gamma of a low-level step.

    Attributes:
        open: Whether an episode has begun and is not over.
    """

    def __init__(self, now: float, time_step: float, discount: float) -> None:
        self._time_step, self._discount = time_step, discount
        self._number, self._reward, self._decided_at = 0, 0.0, now
        self.open = False

    def credit(self, reward: float, began: float, longest: float) -> bool:
        """Count what an option brought that began at some time [s], as seen from the last decision.

        So discounted, the joint rewards of an episode add up to what its options' rewards do. An option counts as one
        that began `longest` [s] before that decision at most, whatever is said of it. Return False where the result is
        too large for a number, and nothing is counted.
        """
        began = max(began, self._decided_at - longest)
        try:
            total = self._reward + self._discount ** round((began - self._decided_at) / self._time_step) * reward
        except OverflowError:
            return False
        if not math.isfinite(total):
            return False
        self._reward = total
        return True

    def step(
        self,
        now: ClockReading,
        epoch: int,
        asked: PolicyQuery,
        options: JointOptions,
        log_probability: float = 0.0,
        digest: str = "",
        terminated: bool = False,
        truncated: bool = False,
    ) -> JointStep:
        """Return a decision: what was asked, what all run from now on, by which policy; or an episode's last step."""
        self.open = not (terminated or truncated)
        out = JointStep(
            stamp=now.stamp,
            coordinator_epoch=epoch,
            step=self._number,
            policy_digest=digest,
            running=asked.running >= 0,
            absent=options < 0,
            options=options,
            legal=asked.legal,
            observation=asked.observation,
            log_probability=log_probability,
            reward=self._reward,
            duration=round((now.task - self._decided_at) / self._time_step),
            terminated=terminated,
            truncated=truncated,
        )
        self._number, self._reward, self._decided_at = self._number + 1, 0.0, now.task
        return out

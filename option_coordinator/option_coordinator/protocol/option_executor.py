"""What runs a robot's options: its interface for the client of the coordinator. No ROS, no clock."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

from option_coordinator.options.options import Mask, Observation


class AgentObservation(NamedTuple):
    """Observation of a robot, sent with a request.

    Attributes:
        observation: Observation for the policy (observation_size,).
        legal: Whether the robot may start each of its options (K,); empty for all.
        work: What must outlive the robot's process, in its own words, at most 255 bytes; empty for nothing.
    """

    observation: Observation
    legal: Mask
    work: str = ""


class OptionResult(NamedTuple):
    """Reward and duration of a completed option.

    Attributes:
        reward: Discounted reward sum_i gamma^i r_i, this robot's share of the team's reward.
        steps: Number of low-level steps.
    """

    reward: float = 0.0
    steps: int = 0


class OptionExecutor(Protocol):
    """Runs options; calls `OptionClient.ended` when one has terminated."""

    def observe(self) -> AgentObservation:
        """Return the current observation."""

    def begin(self, option: int) -> None:
        """Start an option."""

    def leave(self) -> OptionResult:
        """Stop the running option immediately and return its result."""


@runtime_checkable
class Resumes(Protocol):
    """An executor whose work outlives its process."""

    def resume(self, work: str) -> None:
        """Take over the work that it observed before its restart, see `AgentObservation.work`.

        Raises:
            OptionError: The text is not its work.
        """

"""Settings of a coordinator: its robots and its waiting times."""

from __future__ import annotations

from dataclasses import dataclass

from option_coordinator.errors import OptionError
from option_coordinator.options.options import Agent
from option_coordinator.protocol.message_checks import LONGEST


@dataclass(frozen=True)
class RobotSpec:
    """A robot with the durations and the safe option that a coordinator must know.

    Attributes:
        agent: Name, options and observation size.
        durations: Longest time that each of its options may take [s].
        safe_option: Index of the option that it is granted if the policy fails.
    """

    agent: Agent
    durations: tuple[float, ...]
    safe_option: int = 0

    def __post_init__(self) -> None:
        if len(self.durations) != len(self.agent.options) or not all(0.0 < d <= LONGEST for d in self.durations):
            raise OptionError(
                f"'{self.agent.name}': durations must be positive, at most {LONGEST:g} s, one for each option"
            )
        if not 0 <= self.safe_option < len(self.durations):
            raise OptionError(f"'{self.agent.name}': safe option {self.safe_option} is none of its options")


@dataclass(frozen=True)
class CoordinatorTimeouts:
    """Waiting times of a coordinator [s].

    Attributes:
        batch_window: Time that the first pending request waits for others.
        lease: Silence after which a robot is suspect; a coordinator listens for as long before it decides.
        lost_after: Silence after which a robot is lost.
        repeat: Time between repetitions of an unacknowledged grant.
        stale: Age at which an observation is refused.
        policy_limit: Time after which a policy has failed.
        time_step: Duration of a low-level step, the unit of reported durations.
    """

    batch_window: float = 0.0
    lease: float = 0.5
    lost_after: float = 2.0
    repeat: float = 0.1
    stale: float = 2.0
    policy_limit: float = 0.05
    time_step: float = 1.0

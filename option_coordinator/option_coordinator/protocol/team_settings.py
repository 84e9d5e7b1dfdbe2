"""What a coordinator must be told before it begins: its robots, and how long it waits for what."""

from __future__ import annotations

from dataclasses import dataclass

from option_coordinator.errors import OptionError
from option_coordinator.options.options import Agent
from option_coordinator.protocol.message_checks import LONGEST


@dataclass(frozen=True)
class RobotSpec:
    """What a coordinator must know of a robot beside what it can do.

    Attributes:
        agent: name, options and observation.
        durations: longest time that each of its options may take [s].
        safe_option: what it is granted where the policy fails.
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
    """All in seconds.

    Attributes:
        batch_window: time that the first request waits for others to be decided with it.
        lease: a robot silent for so long is suspect; a coordinator listens for so long before it decides.
        lost_after: a robot silent for so long is lost.
        repeat: between repetitions of what was not acknowledged.
        stale: age at which an observation is refused.
        policy_limit: a policy that takes longer has failed.
        time_step: of a low-level step, in which durations are told.
    """

    batch_window: float = 0.0
    lease: float = 0.5
    lost_after: float = 2.0
    repeat: float = 0.1
    stale: float = 2.0
    policy_limit: float = 0.05
    time_step: float = 1.0

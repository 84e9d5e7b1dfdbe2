"""A team as known to its coordinator: robots, waiting times, and the query of a decision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from option_coordinator.errors import OptionError
from option_coordinator.options.options import NONE, Agent, PolicyQuery, option_mask
from option_coordinator.protocol.ledger import RobotState
from option_coordinator.protocol.overruns import OverrunLimit
from option_coordinator.protocol.protocol_types import LONGEST, Request


@dataclass(frozen=True)
class RobotSpec:
    """Coordinator settings of one robot.

    Attributes:
        agent: Name, options and observation size.
        durations: Maximum duration of each option [s].
        safe_option: Index of the option to grant if the policy fails.
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
    """Limits of a coordinator; times in [s].

    Attributes:
        batch_window: Time for which the first pending request waits for others.
        lease: Silence after which a robot is suspect; also the listening time before a coordinator decides.
        lost_after: Silence after which a robot is lost.
        repeat: Repetition period of an unacknowledged grant.
        stale: Age above which an observation is refused.
        policy_limit: Time limit of a policy query.
        time_step: Duration of a low-level step, the unit of reported durations.
        most_overruns: Consecutive overruns after which a robot is not granted an option again; 0 for no limit.
    """

    batch_window: float = 0.0
    lease: float = 0.5
    lost_after: float = 2.0
    repeat: float = 0.1
    stale: float = 2.0
    policy_limit: float = 0.05
    time_step: float = 1.0
    most_overruns: int = 3


class TeamQuery:
    """Keeps each robot's latest observation and builds policy queries from them.

    Args:
        robots: Robots, in the policy's order.
        overruns: Options that overran too often, which are not legal.

    Attributes:
        index: Index of each robot in the policy's order, by name.
        safe_options: Safe option of each robot, in the policy's order.
    """

    def __init__(self, robots: Sequence[RobotSpec], overruns: OverrunLimit) -> None:
        self._overruns = overruns
        self._agents = [robot.agent for robot in robots]
        names = [agent.name for agent in self._agents]
        self.index = {name: index for index, name in enumerate(names)}
        self.safe_options = [robot.safe_option for robot in robots]
        self._options = option_mask([len(robot.agent.options) for robot in robots])
        ends = np.cumsum([robot.agent.observation_size for robot in robots]).tolist()
        self._places = {name: slice(*ends) for name, ends in zip(names, pairwise([0, *ends]), strict=True)}
        self._observed = np.zeros(ends[-1], np.float32)

    def observe(self, request: Request) -> None:
        """Store the observation of a validated request."""
        self._observed[self._places[request.agent]] = request.observation

    def of(self, requests: Mapping[str, Request], ledger: Mapping[str, RobotState]) -> PolicyQuery:
        """Return the query in which the robots in `requests` choose, and the others run the options in the ledger."""
        legal, choosing = self._options.copy(), np.zeros(len(self.index), bool)
        for name, request in requests.items():
            index, agent = self.index[name], self._agents[self.index[name]]
            choosing[index] = True
            legal[index, : len(agent.options)] = self._overruns.allowed(agent, request.legal)
        running = np.array([entry.option if entry.runs else NONE for entry in ledger.values()])
        return PolicyQuery(self._observed.copy(), choosing, running, legal)

"""The query of a policy about a team: latest observations, choosing robots, running options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from option_coordinator.options.decision import NONE, PolicyQuery
from option_coordinator.options.options import option_mask
from option_coordinator.protocol.ledger import Entry
from option_coordinator.protocol.protocol_types import Request
from option_coordinator.protocol.team_settings import RobotSpec


class TeamQuery:
    """Keeps the latest observation of each robot, and builds the query of a decision from it.

    Args:
        robots: Robots, in the policy's order.

    Attributes:
        index: Index of each robot in the policy's order, by name.
        safe_options: Safe option of each robot, in the policy's order.
    """

    def __init__(self, robots: Sequence[RobotSpec]) -> None:
        names = [robot.agent.name for robot in robots]
        self.index = {name: index for index, name in enumerate(names)}
        self.safe_options = [robot.safe_option for robot in robots]
        self._options = option_mask([len(robot.agent.options) for robot in robots])
        ends = np.cumsum([robot.agent.observation_size for robot in robots]).tolist()
        self._places = {name: slice(*ends) for name, ends in zip(names, pairwise([0, *ends]), strict=True)}
        self._observed = np.zeros(ends[-1], np.float32)

    def observe(self, request: Request) -> None:
        """Take the observation of a request that was checked."""
        self._observed[self._places[request.agent]] = request.observation

    def of(self, requests: Mapping[str, Request], ledger: Mapping[str, Entry]) -> PolicyQuery:
        """Return the query in which the robots of `requests` choose, and the others run what the ledger says."""
        legal, choosing = self._options.copy(), np.zeros(len(self.index), bool)
        for name, request in requests.items():
            index = self.index[name]
            choosing[index] = True
            if np.size(request.legal):
                legal[index, : np.size(request.legal)] = request.legal
        running = np.array([entry.option if entry.runs else NONE for entry in ledger.values()])
        return PolicyQuery(self._observed.copy(), choosing, running, legal)

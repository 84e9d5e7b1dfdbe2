"""The requests that wait to be decided together."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from option_coordinator.protocol.protocol_types import Request


class RequestBatch:
    """Pending requests, at most one of each robot.

    One decision serves all robots that ask at about the same time: a decision for each request would cost a team of 50
    most of its time.

    Args:
        window: Time that the first request waits for others [s].
    """

    def __init__(self, window: float) -> None:
        self._window = window
        self._requests: dict[str, Request] = {}
        self._due = math.inf

    def __iter__(self) -> Iterator[str]:
        return iter(self._requests)

    @property
    def waits(self) -> bool:
        """Whether a decision is pending."""
        return self._due < math.inf

    def add(self, request: Request, now: float) -> None:
        """Add a request at a steady time [s]; it replaces an earlier one of the same robot."""
        self._requests[request.agent] = request
        self._due = min(self._due, now + self._window)

    def drop(self, agent: str) -> None:
        """Forget a robot's request, if there is one."""
        self._requests.pop(agent, None)

    def is_due(self, now: float) -> bool:
        """Whether the first request has waited for the window, at a steady time [s]."""
        return now >= self._due

    def take(self, waits: Callable[[str], bool], order: Callable[[str], int]) -> dict[str, Request]:
        """Remove and return the requests to decide now, by robot.

        Args:
            waits: Whether a robot still waits for an answer; a robot that fell silent asks again when it returns.
            order: Index of a robot in the policy's order.
        """
        self._due = math.inf
        agents = sorted((agent for agent in self._requests if waits(agent)), key=order)
        return {agent: self._requests.pop(agent) for agent in agents}

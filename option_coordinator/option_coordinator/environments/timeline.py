"""Options that agents ran, by time: the data of a timeline."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple


class Span(NamedTuple):
    """One run of an option.

    Attributes:
        agent: Name of the robot.
        option: Name of the option.
        begin: Low-level step at which it began; a time [s] in a recording of robots.
        end: Low-level step at which it ended; a time [s] in a recording of robots.
        finished: Whether it ended by itself, neither interrupted nor cut off with the episode.
    """

    agent: str
    option: str
    begin: float
    end: float
    finished: bool


@dataclass
class Trace:
    """The options of an episode, in the order in which they ended."""

    spans: list[Span] = field(default_factory=list)
    _open: dict[str, tuple[str, int]] = field(default_factory=dict)

    def begin(self, agent: str, option: str, step: int) -> None:
        """Note that an agent begins an option."""
        self._open[agent] = (option, step)

    def end(self, agent: str, step: int, finished: bool) -> None:
        """Note that it ended, or was interrupted."""
        option, begin = self._open.pop(agent)
        self.spans.append(Span(agent, option, begin, step, finished))

    def close(self, step: int) -> None:
        """Note that the episode is over."""
        for agent in list(self._open):
            self.end(agent, step, finished=False)

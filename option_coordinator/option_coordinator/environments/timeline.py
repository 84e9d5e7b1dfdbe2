"""Who ran which option when: what a timeline is drawn from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple


class Span(NamedTuple):
    """One option, carried out.

    Attributes:
        agent: name of the robot.
        option: name of the option.
        begin: low-level step at which it began; a time [s] where it was recorded of robots.
        end: and ended.
        finished: by itself, not interrupted and not cut off with the episode.
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

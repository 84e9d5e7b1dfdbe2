"""Limits how often one robot may exceed the maximum duration of one option. No ROS, no clock.

Without a limit, a robot that cannot reach a station would be granted the same option for ever, and a run without an end
has no verdict.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from option_coordinator.options.options import Agent, Mask

_SLACK = 0.02
"""A robot may end an overrun option this much earlier by the coordinator's clock [maximum durations]."""


class OverrunLimit:
    """Counts each robot's consecutive overruns of each option that this coordinator has granted.

    Options that a message only claims to be running do not count, so that a forged one bars nothing.

    An option that has just overrun is not granted in the robot's next decision if another one is legal; after `most`
    overruns in a row it is not granted to that robot again.

    Args:
        most: Number of consecutive overruns after which an option is barred; 0 for no limit.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._counts: dict[str, dict[int, int]] = defaultdict(dict)
        self._last: dict[str, int] = {}
        self._granted: dict[str, tuple[int, float]] = {}

    def began(self, agent: str, option: int, now: float) -> None:
        """Record that a robot was granted an option at a time [s]."""
        self._granted[agent] = option, now

    def ended(self, agent: str, option: int, now: float, longest: float) -> None:
        """Record that an option of a robot with this maximum duration [s] ended at a time [s]."""
        granted, began = self._granted.pop(agent, (option, now))
        self._last.pop(agent, None)
        if granted != option or now - began < (1.0 - _SLACK) * longest:
            self._counts[agent].pop(option, None)
            return
        self._counts[agent][option] = self._counts[agent].get(option, 0) + 1
        self._last[agent] = option

    def forget(self, agent: str) -> None:
        """Start again for a robot whose process was restarted."""
        for known in (self._counts, self._last, self._granted):
            known.pop(agent, None)

    def allowed(self, agent: Agent, legal: Mask) -> Mask:
        """Return which options to grant (K,), from the legal ones (K,), or (0,) for all."""
        out = np.array(legal, bool) if np.size(legal) else np.ones(len(agent.options), bool)
        if not self._counts.get(agent.name):  # the usual case, for which robots wait
            return out
        out[self._barred(agent.name)] = False
        last = self._last.get(agent.name)
        if last is not None and out.sum() > 1:
            out[last] = False
        return out

    def verdict(self, agent: Agent, legal: Mask, safe: int) -> str:
        """Return why nothing is left for a robot but its safe option; empty if something is.

        Args:
            agent: Name and options of the robot.
            legal: Legal options (K,), or (0,) for all.
            safe: Index of the safe option.
        """
        barred = self._barred(agent.name)
        if not barred or (np.flatnonzero(self.allowed(agent, legal)) != safe).any():
            return ""
        names = ", ".join(f"'{agent.options[option]}'" for option in barred)
        return (
            f"{agent.name} is given up: it exceeded the maximum duration of {names} {self._most} times in a row; see "
            "what keeps it from getting there, then restart its node"
        )

    def _barred(self, agent: str) -> list[int]:
        counts = self._counts.get(agent, {})
        return sorted(option for option, count in counts.items() if 0 < self._most <= count)

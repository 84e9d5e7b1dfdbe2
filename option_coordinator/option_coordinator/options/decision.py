"""A moment at which options are chosen: who is ready, what the others run, and what the last options brought."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from option_coordinator.options.options import Agent, Mask, Observation

NONE = -1
"""In place of an option: the agent runs none."""


@dataclass(frozen=True, eq=False)
class Decision:
    """A moment at which options are chosen, and what happened since the last one.

    Attributes:
        agents: the N robots, in the policy's order.
        observation: of all, one after the other; each as it is now, or as it was when the agent's own option ended: see
            `Simulation.observes_while_running`.
        choosing: (N,) who is ready, U_kappa.
        running: (N,) option that each carries out, `NONE` for who is ready or absent.
        present: (N,) who is there; the absent neither choose nor run an option.
        legal: (N, K) which options each that runs none may begin, all its options for the others; K is the largest
            number of options, what lies beyond is False.
        reward: discounted sum of the joint rewards since the last decision, sum_i gamma^i r_i (0 at a reset).
        rewards: those joint rewards.
        discount: gamma^tau, what the value of this moment counts at the last decision.
        terminated: the task is over.
        truncated: it was cut off: nobody is to choose, but the value of this moment still counts. In a synchronous team
            nobody runs on then, as at all its decisions.
    """

    agents: tuple[Agent, ...]
    observation: Observation
    choosing: Mask
    running: NDArray[np.int64]
    present: Mask
    legal: Mask
    reward: float
    rewards: tuple[float, ...]
    discount: float
    terminated: bool
    truncated: bool

    @property
    def duration(self) -> int:
        """Low-level steps since the last decision, tau."""
        return len(self.rewards)

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self.terminated or self.truncated

    @property
    def ready(self) -> tuple[str, ...]:
        """Names of those that choose."""
        return tuple(agent.name for agent, ready in zip(self.agents, self.choosing, strict=True) if ready)

    @property
    def running_options(self) -> dict[str, int]:
        """What the others carry out."""
        return {agent.name: int(o) for agent, o in zip(self.agents, self.running, strict=True) if o != NONE}

    @cached_property
    def observations(self) -> dict[str, Observation]:
        """What each agent observed last."""
        ends = np.cumsum([agent.observation_size for agent in self.agents])
        return dict(zip((a.name for a in self.agents), np.split(self.observation, ends[:-1]), strict=True))

    @property
    def masks(self) -> dict[str, Mask]:
        """Which of its own options each of the ready may begin."""
        rows = zip(self.agents, self.legal, self.choosing, strict=True)
        return {agent.name: row[: len(agent.options)] for agent, row, ready in rows if ready}

    def named(self, options: NDArray[np.int64]) -> dict[str, int]:
        """Return joint options (N,) by the names of those that choose."""
        rows = zip(self.agents, options, self.choosing, strict=True)
        return {agent.name: int(option) for agent, option, chooses in rows if chooses}

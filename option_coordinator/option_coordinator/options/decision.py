"""A decision: the agents that are ready, the options that the others run, and the reward since the last decision."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from option_coordinator.options.options import Agent, Mask, Observation

NONE = -1
"""Index that stands for no option."""


@dataclass(frozen=True, eq=False)
class PolicyQuery:
    """What a policy is asked at a decision.

    Attributes:
        observation: Observations of all agents, one after the other (D,).
        choosing: Whether each agent is ready and chooses, U_kappa (N,).
        running: Option that each agent runs, `NONE` for agents that are ready or absent (N,).
        legal: Whether each option is legal (N, K), with K the largest number of options: those that an idle agent may
            begin, all options of an agent that runs one, False beyond an agent's last option.
    """

    observation: Observation
    choosing: Mask
    running: NDArray[np.int64]
    legal: Mask


@dataclass(frozen=True, eq=False)
class Decision(PolicyQuery):
    """A point in time at which agents choose options, with the reward since the last one.

    Each agent's observation is the current one, or that at the end of its last option, as
    `Simulation.observes_while_running` says.

    Attributes:
        agents: All N robots, in the policy's order.
        present: Whether each agent is present; absent agents neither choose nor run an option (N,).
        reward: Discounted sum of the joint rewards since the last decision, sum_i gamma^i r_i (0 at a reset).
        rewards: Joint reward of each low-level step since the last decision.
        discount: Discount gamma^tau of this decision's value, seen from the last decision.
        terminated: Whether the task is over.
        truncated: Whether the episode was cut off: no agent chooses, but the value of this decision still counts. In a
            synchronous team no option runs on then.
    """

    agents: tuple[Agent, ...]
    present: Mask
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
        """Names of the agents that choose."""
        return tuple(agent.name for agent, ready in zip(self.agents, self.choosing, strict=True) if ready)

    @property
    def running_options(self) -> dict[str, int]:
        """Option of each agent that runs one, by name."""
        return {agent.name: int(o) for agent, o in zip(self.agents, self.running, strict=True) if o != NONE}

    @cached_property
    def observations(self) -> dict[str, Observation]:
        """Last observation of each agent, by name."""
        ends = np.cumsum([agent.observation_size for agent in self.agents])
        return dict(zip((a.name for a in self.agents), np.split(self.observation, ends[:-1]), strict=True))

    @property
    def masks(self) -> dict[str, Mask]:
        """Legal options of each agent that is ready, by name."""
        rows = zip(self.agents, self.legal, self.choosing, strict=True)
        return {agent.name: row[: len(agent.options)] for agent, row, ready in rows if ready}

    def named(self, options: NDArray[np.int64]) -> dict[str, int]:
        """Return the options of the agents that choose, by name, from joint options (N,)."""
        rows = zip(self.agents, options, self.choosing, strict=True)
        return {agent.name: int(option) for agent, option, chooses in rows if chooses}

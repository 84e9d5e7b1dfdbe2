"""Agents with options, and the interface of a simulation that executes options one low-level step at a time.

An option is chosen once and then runs until it terminates (thesis 2.4.2). A `Simulation` implements the options' inner
policies and termination; the caller decides who chooses, and when.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from option_coordinator.errors import OptionError

Observation = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Agent:
    """A robot with its options.

    Attributes:
        name: Name of the robot.
        options: Names of the robot's options; elsewhere options are identified by index.
        observation_size: Length of the robot's observation.
    """

    name: str
    options: tuple[str, ...]
    observation_size: int


def option_mask(counts: Sequence[int]) -> Mask:
    """Return which options exist (N, K), with K the maximum count, for agents with these numbers of options."""
    return np.asarray(np.arange(max(counts)) < np.array(counts)[:, None])


class SimulationStep(NamedTuple):
    """Result of one low-level step.

    Attributes:
        reward: Joint reward r_k of the team.
        ended: Whether each agent's option ended in this step.
        terminated: Whether the task is over.
    """

    reward: float
    ended: tuple[bool, ...]
    terminated: bool


class Scene(NamedTuple):
    """A snapshot to draw.

    Attributes:
        robots: Position of each robot, by name [m].
        note: Text on the part of the state that is not drawn.
    """

    robots: Mapping[str, tuple[float, float]]
    note: str


class Drawable(Protocol):
    """A world that can be drawn."""

    @property
    def room(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Extent in x and in y [m]."""

    @property
    def landmarks(self) -> Mapping[str, tuple[float, float]]:
        """Named positions [m]."""

    def scene(self) -> Scene:
        """Return the current scene."""


class Simulation(Drawable, Protocol):
    """A task's low-level simulation; agents are identified by index."""

    @property
    def agents(self) -> tuple[Agent, ...]:
        """The robots, in the policy's order."""

    @property
    def step_limit(self) -> int:
        """Low-level steps after which an episode is truncated."""

    @property
    def time_step(self) -> float:
        """Duration of a low-level step [s]."""

    @property
    def observes_while_running(self) -> bool:
        """Whether agents observe at every decision, or only when their own option has ended."""

    def reset(self, generator: np.random.Generator) -> None:
        """Start an episode; everything random is drawn from `generator`."""

    def begin(self, agent: int, option: int) -> None:
        """Start an option for an agent without one."""

    def interrupt(self, agent: int) -> None:
        """End an agent's option immediately; its progress is lost."""

    def step(self) -> SimulationStep:
        """Advance by one low-level step; agents without an option stay unchanged."""

    def observe(self, agent: int) -> Observation:
        """Return an agent's current observation."""

    def legal(self, agent: int) -> Mask:
        """Return the options that an agent may start now."""

    def figures(self) -> dict[str, Any]:
        """Return the metrics of the episode so far, as JSON values."""


def check_option(agent: Agent, option: int) -> None:
    """Raise unless an index is one of the agent's options.

    Raises:
        OptionError: The index is invalid.
    """
    if not 0 <= option < len(agent.options):
        raise OptionError(f"{agent.name} has no option {option}: there are 0 to {len(agent.options) - 1}")


NONE = -1
"""Index that represents no option."""


@dataclass(frozen=True, eq=False)
class PolicyQuery:
    """A query to a policy: the choosing agents, the running options, and the legal options.

    Attributes:
        observation: Observations of all agents, concatenated (D,).
        choosing: Whether each agent is ready and chooses, U_kappa (N,).
        running: Option that each agent runs, `NONE` for agents that are ready or absent (N,).
        legal: Whether each option is legal (N, K), with K the maximum number of options: the options that an idle agent
            may start, all options of an agent that runs one, and False beyond an agent's last option.
    """

    observation: Observation
    choosing: Mask
    running: NDArray[np.int64]
    legal: Mask


@dataclass(frozen=True, eq=False)
class Decision(PolicyQuery):
    """A time at which agents choose options, with the reward since the previous decision.

    Depending on `Simulation.observes_while_running`, each agent's observation is the current one or that at the end of
    its last option.

    Attributes:
        agents: All N robots, in the policy's order.
        present: Whether each agent is present; absent agents neither choose nor run an option (N,).
        reward: Discounted joint reward since the last decision, sum_i gamma^i r_i (0 at a reset).
        rewards: Joint reward of each low-level step since the last decision.
        discount: Discount gamma^tau of this decision's value relative to the last decision.
        terminated: Whether the task is over.
        truncated: Whether the episode was truncated: no agent chooses, but the value of this decision still counts. In
            a synchronous team, no option continues in that case.
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
        """Running options by agent name."""
        return {agent.name: int(o) for agent, o in zip(self.agents, self.running, strict=True) if o != NONE}

    @cached_property
    def observations(self) -> dict[str, Observation]:
        """Latest observation of each agent, by name."""
        ends = np.cumsum([agent.observation_size for agent in self.agents])
        return dict(zip((a.name for a in self.agents), np.split(self.observation, ends[:-1]), strict=True))

    @property
    def masks(self) -> dict[str, Mask]:
        """Legal options of each ready agent, by name."""
        rows = zip(self.agents, self.legal, self.choosing, strict=True)
        return {agent.name: row[: len(agent.options)] for agent, row, ready in rows if ready}

    def named(self, options: NDArray[np.int64]) -> dict[str, int]:
        """Return the options of the choosing agents by name, from joint options (N,)."""
        rows = zip(self.agents, options, self.choosing, strict=True)
        return {agent.name: int(option) for agent, option, chooses in rows if chooses}

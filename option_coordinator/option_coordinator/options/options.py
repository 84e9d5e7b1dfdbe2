"""Options of several robots, and the seam behind which a task carries them out one low-level step at a time.

An option is chosen once and then runs for as many steps as it takes (thesis 2.4.2). A `Simulation` knows the options'
inner policies and how they end; it knows nothing of who chooses them, nor when.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from option_coordinator.errors import OptionError

Observation = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Agent:
    """A robot and what it can do.

    Attributes:
        name: of the robot.
        options: their names; an option is known by its index.
        observation_size: length of what it observes.
    """

    name: str
    options: tuple[str, ...]
    observation_size: int


def option_mask(counts: Sequence[int]) -> Mask:
    """Return which options there are, (N, K) with K the largest count, of agents with so many each."""
    return np.asarray(np.arange(max(counts)) < np.array(counts)[:, None])


class SimulationStep(NamedTuple):
    """What one low-level step brought.

    Attributes:
        reward: the joint reward r_k.
        ended: whether each agent's option ended with it.
        terminated: the task is over.
    """

    reward: float
    ended: tuple[bool, ...]
    terminated: bool


class Scene(NamedTuple):
    """What a picture of one moment needs.

    Attributes:
        robots: position of each robot [m].
        note: in words, what cannot be seen.
    """

    robots: Mapping[str, tuple[float, float]]
    note: str


class Drawable(Protocol):
    """What pictures are made of."""

    @property
    def room(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Extent in x and in y [m]."""

    @property
    def landmarks(self) -> Mapping[str, tuple[float, float]]:
        """Named positions [m]."""

    def scene(self) -> Scene:
        """Return this moment."""


class Simulation(Drawable, Protocol):
    """A task's low-level world. Agents are known by their index."""

    @property
    def agents(self) -> tuple[Agent, ...]:
        """The robots, in the policy's order."""

    @property
    def step_limit(self) -> int:
        """Low-level steps after which an episode is cut off."""

    @property
    def time_step(self) -> float:
        """Of a low-level step [s]."""

    @property
    def observes_while_running(self) -> bool:
        """Whether who runs an option is asked for what it sees at every decision, or only when its own option ends."""

    def reset(self, generator: np.random.Generator) -> None:
        """Begin an episode; whatever is random in it is drawn from `generator`."""

    def begin(self, agent: int, option: int) -> None:
        """Let an agent that runs no option begin one."""

    def interrupt(self, agent: int) -> None:
        """Take an agent's option from it, with whatever it had done towards its end."""

    def step(self) -> SimulationStep:
        """Let a low-level step pass; an agent without an option stays as it is."""

    def observe(self, agent: int) -> Observation:
        """Return what an agent sees now."""

    def legal(self, agent: int) -> Mask:
        """Return which options an agent may begin now."""

    def figures(self) -> dict[str, Any]:
        """Return what there is to say about the episode so far, as JSON."""


def check_option(agent: Agent, option: int) -> None:
    """Refuse an index that is none of the agent's options.

    Raises:
        OptionError: it is not.
    """
    if not 0 <= option < len(agent.options):
        raise OptionError(f"{agent.name} has no option {option}: there are 0 to {len(agent.options) - 1}")

"""An environment that asks only when somebody is ready: option steps kappa on top of low-level steps k (thesis 5.2.3).

    environment = OptionEnvironment(ToolDeliverySimulation(load_task("tool_delivery")), discount=0.99)
    decision = environment.reset(seed=0)
    while not decision.over:
        decision = environment.step({name: choose(name) for name in decision.ready})

Who is ready is a matter of the termination strategy (thesis 2.4.3):

    "async"  eta_continue: whoever has ended its option; the others go on (the thesis's)
    "wait"   eta_all: all, once all have ended; who is early idles ("sync-wait")
    "cut"    eta_any: all, once anyone has ended; the others are interrupted ("sync-cut")
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from option_coordinator.errors import OptionError
from option_coordinator.options import Agent, Mask, Observation, Scene, Simulation, check_option
from option_coordinator.trace import Trace

Synchronisation = Literal["async", "wait", "cut"]
NONE = -1
"""In place of an option: the agent runs none."""


@dataclass(frozen=True, eq=False)
class Decision:
    """A moment at which options are chosen, and what happened since the last one.

    Attributes:
        agents: the N robots, in the policy's order.
        observation: of all, each as it was when the agent's own option ended, one after the other.
        choosing: (N,) who is ready, U_kappa.
        running: (N,) option that each carries out, `NONE` for who is ready.
        legal: (N, K) which options each may begin; K is the largest number of options, what lies beyond is False.
        reward: discounted sum of the joint rewards since the last decision, sum_i gamma^i r_i (0 at a reset).
        rewards: those joint rewards.
        discount: gamma^tau, what the value of this moment counts at the last decision.
        terminated: the task is over.
        truncated: it was cut off: nobody is to choose, but the value of this moment still counts.
    """

    agents: tuple[Agent, ...]
    observation: Observation
    choosing: Mask
    running: NDArray[np.int64]
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


class OptionEnvironment:
    """See the module.

    Args:
        simulation: the low-level world.
        discount: gamma of a low-level step.
        synchronisation: who chooses when.
        film: whether to keep a scene of every low-level step, to be drawn.

    Attributes:
        trace: who ran which option when, in this episode.
        scenes: of this episode, the first before any step; none unless filmed.
        steps: low-level steps of this episode.
    """

    def __init__(
        self,
        simulation: Simulation,
        discount: float = 0.99,
        synchronisation: Synchronisation = "async",
        film: bool = False,
    ) -> None:
        self.simulation = simulation
        self.agents = simulation.agents
        self.discount = discount
        self.synchronisation = synchronisation
        self.trace = Trace()
        self.scenes: list[Scene] = []
        self.steps = 0
        self._film = film
        self._index = {agent.name: i for i, agent in enumerate(self.agents)}
        self._seen: list[Observation] = []
        self._running = np.full(len(self.agents), NONE)
        self._decision: Decision | None = None
        self._mask = option_mask(self.agents)

    def reset(self, seed: int | np.random.Generator | None = None) -> Decision:
        """Begin an episode, in which all are ready."""
        self.simulation.reset(np.random.default_rng(seed))
        self.trace = Trace()
        self.scenes = []
        self._take_scene()
        self.steps = 0
        self._running[:] = NONE
        count = len(self.agents)
        self._seen = [self.simulation.observe(i) for i in range(count)]
        return self._decide(np.ones(count, dtype=bool), (), terminated=False, truncated=False)

    def step(self, choices: Mapping[str, int]) -> Decision:
        """Let the ready begin their options and run until somebody must choose again.

        Args:
            choices: an option for each agent that is ready, and for no other.

        Raises:
            OptionError: the episode is over, the agents are not those that are ready, or an option is not legal.
        """
        for agent, option in self._checked(choices):
            self.simulation.begin(agent, option)
            self._running[agent] = option
            self.trace.begin(self.agents[agent].name, self.agents[agent].options[option], self.steps)
        rewards: list[float] = []
        while True:
            reward, ended, terminated = self.simulation.step()
            rewards.append(reward)
            self.steps += 1
            self._take_scene()
            for index in np.flatnonzero(ended):
                self._end(int(index), finished=True)
            truncated = not terminated and self.steps >= self.simulation.step_limit
            idle = self._running == NONE
            if terminated or truncated or (idle.all() if self.synchronisation == "wait" else idle.any()):
                return self._pause(rewards, terminated, truncated)

    def _take_scene(self) -> None:
        if self._film:
            self.scenes.append(self.simulation.scene())

    def _pause(self, rewards: list[float], terminated: bool, truncated: bool) -> Decision:
        over = terminated or truncated
        if over:
            self.trace.close(self.steps)
        elif self.synchronisation == "cut":
            for agent in np.flatnonzero(self._running != NONE):
                self.simulation.interrupt(int(agent))
                self._end(int(agent), finished=False)
        choosing = self._running == NONE
        for agent in np.flatnonzero(choosing):
            self._seen[agent] = self.simulation.observe(int(agent))
        return self._decide(choosing & (not over), tuple(rewards), terminated, truncated)

    def _end(self, agent: int, finished: bool) -> None:
        self._running[agent] = NONE
        self.trace.end(self.agents[agent].name, self.steps, finished)

    def _decide(self, choosing: Mask, rewards: tuple[float, ...], terminated: bool, truncated: bool) -> Decision:
        legal = self._mask.copy()
        for agent in np.flatnonzero(choosing):
            legal[agent, : len(self.agents[agent].options)] = self.simulation.legal(int(agent))
        self._decision = Decision(
            agents=self.agents,
            observation=np.concatenate(self._seen),
            choosing=choosing,
            running=self._running.copy(),
            legal=legal,
            reward=discounted(rewards, self.discount),
            rewards=rewards,
            discount=self.discount ** len(rewards),
            terminated=terminated,
            truncated=truncated,
        )
        return self._decision

    def _checked(self, choices: Mapping[str, int]) -> list[tuple[int, int]]:
        decision = self._decision
        if decision is None or decision.over:
            raise OptionError("there is no episode under way: call reset()")
        if set(choices) != set(decision.ready):
            raise OptionError(f"options are given for {sorted(choices)}, ready are {sorted(decision.ready)}")
        out = []
        for name, option in choices.items():
            agent = self._index[name]
            check_option(self.agents[agent], int(option))
            if not decision.legal[agent, option]:
                raise OptionError(f"{name}: option '{self.agents[agent].options[option]}' is not legal now")
            out.append((agent, int(option)))
        return sorted(out)

    def figures(self) -> dict[str, Any]:
        """Return what there is to say about the episode so far."""
        return {"steps": self.steps, **self.simulation.figures()}


def option_mask(agents: tuple[Agent, ...]) -> Mask:
    """Return (N, K): which option indices each agent has."""
    counts = np.array([len(agent.options) for agent in agents])
    return np.arange(counts.max()) < counts[:, None]


def discounted(rewards: tuple[float, ...], discount: float) -> float:
    """Return sum_i gamma^i r_i."""
    total = 0.0
    for reward in reversed(rewards):
        total = reward + discount * total
    return total

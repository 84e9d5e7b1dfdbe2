"""An event-driven environment: option steps kappa, at which agents choose, over low-level steps k (thesis 5.2.3).

    environment = OptionEnvironment(ToolDeliverySimulation(load_task("tool_delivery")), discount=0.99)
    decision = environment.reset(seed=0)
    while not decision.over:
        decision = environment.step({name: choose(name) for name in decision.ready})

The termination strategy determines which agents are ready (thesis 2.4.3):

    "async"  eta_continue: agents whose option has ended; the others continue (used in the thesis)
    "wait"   eta_all: all agents, once all options have ended; early ones idle ("sync-wait")
    "cut"    eta_any: all agents, once one option has ended; the others are interrupted ("sync-cut")
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from option_coordinator.errors import OptionError
from option_coordinator.options.options import (
    NONE,
    Decision,
    Mask,
    Observation,
    Scene,
    Simulation,
    check_option,
    option_mask,
)

_PART = 4


class RobotDropout(NamedTuple):
    """A period in which a robot is absent.

    Attributes:
        agent: Index of the robot.
        begin: Low-level step after which the robot is absent.
        end: Low-level step after which it is present again, without an option.
    """

    agent: int
    begin: int
    end: int


def draw_dropout(chance: float, agents: int, step_limit: int, generator: np.random.Generator) -> RobotDropout | None:
    """Draw an episode's drop-out, or None.

    Args:
        chance: Probability of a drop-out, 0 to 1.
        agents: Number of robots, all equally likely to drop out.
        step_limit: Step limit of the episode; a drop-out starts in its first quarter and lasts at most a quarter.
        generator: Random generator; unused if the probability is 0.
    """
    if chance == 0.0 or generator.random() >= chance:
        return None
    longest = max(1, step_limit // _PART)
    begin = 1 + int(generator.integers(longest))
    return RobotDropout(int(generator.integers(agents)), begin, begin + 1 + int(generator.integers(longest)))


class Span(NamedTuple):
    """One run of an option.

    Attributes:
        agent: Name of the robot.
        option: Name of the option.
        begin: Low-level step of the start; for recordings of robots, the time [s].
        end: Low-level step of the end; for recordings of robots, the time [s].
        finished: Whether the option terminated, rather than being interrupted or ending with the episode.
    """

    agent: str
    option: str
    begin: float
    end: float
    finished: bool


@dataclass
class Trace:
    """Option runs of an episode, in order of their ends."""

    spans: list[Span] = field(default_factory=list)
    _open: dict[str, tuple[str, int]] = field(default_factory=dict)

    def begin(self, agent: str, option: str, step: int) -> None:
        """Record that an agent starts an option."""
        self._open[agent] = (option, step)

    def end(self, agent: str, step: int, finished: bool) -> None:
        """Record that an agent's option ended or was interrupted."""
        option, begin = self._open.pop(agent)
        self.spans.append(Span(agent, option, begin, step, finished))

    def close(self, step: int) -> None:
        """Record the end of the episode."""
        for agent in list(self._open):
            self.end(agent, step, finished=False)


Synchronisation = Literal["async", "wait", "cut"]


class OptionEnvironment:
    """An environment in which agents choose options whenever the termination strategy makes them ready.

    Args:
        simulation: Low-level simulation of the task.
        discount: Discount factor gamma of a low-level step.
        synchronisation: Termination strategy: "async", "wait" or "cut".
        drop: Probability of a robot's temporary drop-out in an episode, see `draw_dropout`.
        film: Whether to keep a scene for every low-level step, for animations.

    Attributes:
        trace: Option runs of this episode.
        scenes: Scenes of this episode, the first one before any step; empty unless `film` is set.
        steps: Number of low-level steps in this episode so far.
    """

    def __init__(
        self,
        simulation: Simulation,
        discount: float = 0.99,
        synchronisation: Synchronisation = "async",
        film: bool = False,
        drop: float = 0.0,
    ) -> None:
        self.simulation = simulation
        self.agents = simulation.agents
        self.discount = discount
        self.synchronisation = synchronisation
        self.drop = drop
        self.trace = Trace()
        self.scenes: list[Scene] = []
        self.steps = 0
        self._film = film
        self._index = {agent.name: i for i, agent in enumerate(self.agents)}
        self._seen: list[Observation] = []
        self._running = np.full(len(self.agents), NONE)
        self._present = np.ones(len(self.agents), dtype=bool)
        self._dropout: RobotDropout | None = None
        self._decision: Decision | None = None
        self._mask = option_mask([len(agent.options) for agent in self.agents])

    def reset(self, seed: int | np.random.Generator | None = None) -> Decision:
        """Start an episode, with all agents ready."""
        generator = np.random.default_rng(seed)
        self.simulation.reset(generator)
        self._dropout = draw_dropout(self.drop, len(self.agents), self.simulation.step_limit, generator)
        self.trace = Trace()
        self.scenes = []
        self._take_scene()
        self.steps = 0
        self._running[:] = NONE
        self._present[:] = True
        count = len(self.agents)
        self._seen = [self.simulation.observe(i) for i in range(count)]
        return self._decide(np.ones(count, dtype=bool), (), terminated=False, truncated=False)

    def step(self, choices: Mapping[str, int]) -> Decision:
        """Start the options of the ready agents, and run until an agent must choose again.

        Args:
            choices: Option of each ready agent, and of no others.

        Raises:
            OptionError: The episode is over, `choices` does not match the ready agents, or an option is illegal.
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
            self._vanish_or_return()
            truncated = not terminated and self.steps >= self.simulation.step_limit
            if terminated or truncated or self._is_time():
                return self._pause(rewards, terminated, truncated)

    def _is_time(self) -> bool:
        """Return whether an agent must choose."""
        runs_none = self._running == NONE
        ready = bool((runs_none & self._present).any())
        return ready and (self.synchronisation != "wait" or bool(runs_none.all()))

    def _vanish_or_return(self) -> None:
        if self._dropout is None:
            return
        agent, begin, end = self._dropout
        if self.steps == begin:
            self._present[agent] = False
            if self._running[agent] != NONE:
                self.simulation.interrupt(agent)
                self._end(agent, finished=False)
        elif self.steps == end:
            self._present[agent] = True

    def _take_scene(self) -> None:
        if self._film:
            self.scenes.append(self.simulation.scene())

    def _pause(self, rewards: list[float], terminated: bool, truncated: bool) -> Decision:
        over = terminated or truncated
        if self.synchronisation == "cut" or (over and self.synchronisation == "wait"):
            # Also at a time-out: a synchronous team never learns the value of states in which an option continues.
            for agent in np.flatnonzero(self._running != NONE):
                self.simulation.interrupt(int(agent))
                self._end(int(agent), finished=False)
        if over:
            self.trace.close(self.steps)
        idle = self._present & (self._running == NONE)
        looking = self._present if self.simulation.observes_while_running else idle
        for agent in np.flatnonzero(looking):
            self._seen[agent] = self.simulation.observe(int(agent))
        return self._decide(idle, tuple(rewards), terminated, truncated)

    def _end(self, agent: int, finished: bool) -> None:
        self._running[agent] = NONE
        self.trace.end(self.agents[agent].name, self.steps, finished)

    def _decide(self, idle: Mask, rewards: tuple[float, ...], terminated: bool, truncated: bool) -> Decision:
        legal = self._mask.copy()
        for agent in np.flatnonzero(idle):
            legal[agent, : len(self.agents[agent].options)] = self.simulation.legal(int(agent))
        self._decision = Decision(
            agents=self.agents,
            observation=np.concatenate(self._seen),
            choosing=idle & (not (terminated or truncated)),
            running=self._running.copy(),
            present=self._present.copy(),
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
            raise OptionError("no episode is running: call reset()")
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
        """Return the episode's metrics so far."""
        return {"steps": self.steps, **self.simulation.figures()}


def discounted(rewards: tuple[float, ...], discount: float) -> float:
    """Return sum_i gamma^i r_i."""
    total = 0.0
    for reward in reversed(rewards):
        total = reward + discount * total
    return total

"""Hand-written policies: baselines for learning, and optimal policies for tests."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ctrl_rl_core import ToolDelivery
from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.environments.tasks.team_delivery import TeamDeliverySimulation
from option_coordinator.environments.tasks.tool_delivery import (
    GET_TOOL,
    GO_TO_WS,
    PASS_TO_0,
    PASS_TO_1,
    SEARCH,
    WAIT,
    ToolDeliverySimulation,
)
from option_coordinator.environments.tasks.water_filling import WaterFillingSimulation
from option_coordinator.options.options import Agent, Decision
from option_coordinator.scripted.policy_queries import spread_policy
from option_coordinator.teams.team_file import TeamFile


class DecisionPolicy(Protocol):
    """Chooses options for the ready agents."""

    def __call__(self, decision: Decision, /) -> dict[str, int]:
        """Return an option for each ready agent."""


class RandomPolicy:
    """Chooses uniformly among the legal options."""

    def __init__(self, seed: int = 0) -> None:
        self._random = np.random.default_rng(seed)

    def __call__(self, decision: Decision) -> dict[str, int]:
        """Return an option for each ready agent."""
        return {name: int(self._random.choice(np.flatnonzero(mask))) for name, mask in decision.masks.items()}


class ToolDeliveryScript:
    """The optimal policy of Tool Delivery: 40 steps, a return of 260."""

    PLAN = (SEARCH, PASS_TO_1, SEARCH + 1, PASS_TO_0, SEARCH + 2, WAIT, PASS_TO_1)
    """Options of the Fetchbot: the nearer turtlebot 1 delivers the first tool and is back in time for the last."""

    def __init__(self, task: ToolDelivery) -> None:
        self._fetchbot = task.fetchbot.name
        basket = 4 + task.stages
        self._basket = slice(basket, basket + len(task.tools))
        self._done = 0

    def __call__(self, decision: Decision) -> dict[str, int]:
        """Return an option for each ready agent."""
        if not decision.rewards:
            self._done = 0
        return {name: self._choose(name, decision) for name in decision.ready}

    def _choose(self, name: str, decision: Decision) -> int:
        if name != self._fetchbot:
            return GO_TO_WS if decision.observations[name][self._basket].any() else GET_TOOL
        option = self.PLAN[self._done] if self._done < len(self.PLAN) else WAIT
        self._done += 1
        return option


class JarCycle:
    """A fixed cycle: the vehicle fills and the drone inspects one jar after the other, regardless of the levels."""

    def __init__(self) -> None:
        self._next: dict[str, int] = {}

    def __call__(self, decision: Decision) -> dict[str, int]:
        """Return an option for each ready agent."""
        if not decision.rewards:
            self._next = {}
        out = {}
        for agent in decision.agents:
            if agent.name in decision.ready:
                trips = jar_trips(agent)
                turn = self._next.get(agent.name, 0)
                out[agent.name], self._next[agent.name] = trips[turn % len(trips)], turn + 1
        return out


class GreedyFiller:
    """Knows every level: the vehicle fills the jar with the highest gain per distance."""

    def __init__(self, simulation: WaterFillingSimulation) -> None:
        self._simulation = simulation
        self._cycle = JarCycle()

    def __call__(self, decision: Decision) -> dict[str, int]:
        """Return an option for each ready agent."""
        out = self._cycle(decision)
        vehicle = decision.agents[0]
        if vehicle.name in out:
            levels = self._simulation.levels
            here = np.array(self._simulation.scene().robots[vehicle.name])
            ways = np.array([np.abs(np.subtract(place, here)).sum() for place in self._simulation.landmarks.values()])
            loss = 1.0 / (levels + self._simulation.task.level_offset) - 1.0
            out[vehicle.name] = jar_trips(vehicle)[int(np.argmax(loss / (1.0 + ways)))]
        return out


class SpreadTeam:
    """The coordinator's scripted policy for a delivery team: the assignment with the least travel and queueing time."""

    def __init__(self, team: TeamFile) -> None:
        self._chooses = spread_policy(team)

    def __call__(self, decision: Decision) -> dict[str, int]:
        """Return an option for each ready agent."""
        return decision.named(self._chooses(decision)[0])


def jar_trips(agent: Agent) -> list[int]:
    """Return an agent's options that lead to each jar, in jar order; preferably those that also fill it."""
    fill = [index for index, name in enumerate(agent.options) if name.startswith("NavToFill")]
    return fill or [index for index, name in enumerate(agent.options) if name.startswith("NavTo:")]


def scripted_policy(environment: OptionEnvironment) -> DecisionPolicy:
    """Return the hand-written policy of an environment's task."""
    simulation = environment.simulation
    if isinstance(simulation, ToolDeliverySimulation):
        return ToolDeliveryScript(simulation.task)
    return SpreadTeam(simulation.team) if isinstance(simulation, TeamDeliverySimulation) else JarCycle()


def references(environment: OptionEnvironment) -> dict[str, DecisionPolicy]:
    """Return reference policies by name: the hand-written one, and one with access to the hidden state."""
    simulation = environment.simulation
    omniscient = {"omniscient": GreedyFiller(simulation)} if isinstance(simulation, WaterFillingSimulation) else {}
    return {"scripted": scripted_policy(environment), **omniscient}

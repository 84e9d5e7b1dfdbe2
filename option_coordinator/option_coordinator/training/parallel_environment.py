"""A PettingZoo Parallel environment of joint options, for third-party learning libraries.

environment = ParallelOptions(make_environment("tool_delivery"))

PettingZoo expects an action from every agent in every step. A step here is an option step: the action mask of an agent
that is still running an option allows only that option.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.errors import OptionError
from option_coordinator.options.options import NONE, Decision

AgentDict = dict[str, NDArray[Any]]


class ParallelOptions(ParallelEnv[str, AgentDict, int]):
    """Every agent observes a dictionary of `observation` and `action_mask`, and receives the joint reward r_kappa.

    Infos of each agent: `duration` (tau, low-level steps), `discount` (gamma^tau) and `ready`.

    Args:
        environment: Event-driven environment to adapt.
    """

    metadata = {"name": "options_v0", "render_modes": []}  # noqa: RUF012 - as PettingZoo has it
    render_mode = None

    def __init__(self, environment: OptionEnvironment) -> None:
        self.environment = environment
        self.possible_agents = [agent.name for agent in environment.agents]
        self.agents: list[str] = []
        self._decision: Decision | None = None
        self._actions = {agent.name: spaces.Discrete(len(agent.options)) for agent in environment.agents}
        self._observations = {
            agent.name: spaces.Dict(
                {
                    "observation": spaces.Box(-np.inf, np.inf, (agent.observation_size,), np.float32),
                    "action_mask": spaces.MultiBinary(len(agent.options)),
                }
            )
            for agent in environment.agents
        }

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the observation space of an agent."""
        return self._observations[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the action space of an agent: its options."""
        return self._actions[agent]

    def reset(
        self,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002 - PettingZoo's signature
    ) -> tuple[dict[str, AgentDict], dict[str, dict[str, Any]]]:
        """Start an episode."""
        decision = self.environment.reset(seed)
        self.agents = list(self.possible_agents)
        self._decision = decision
        return self._seen(decision), self._told(decision)

    def step(
        self, actions: dict[str, int]
    ) -> tuple[dict[str, AgentDict], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Start the options of the ready agents; the others must continue theirs.

        Raises:
            OptionError: As for `OptionEnvironment.step`, or the mask forbids an action.
        """
        if self._decision is None:
            raise OptionError("no episode is running: call reset()")
        for name, option in self._decision.running_options.items():
            if actions.get(name, option) != option:
                raise OptionError(f"{name} still runs option {option}: its action mask allows nothing else")
        decision = self.environment.step({name: int(actions[name]) for name in self._decision.ready if name in actions})
        self._decision = decision
        names = self.agents
        if decision.over:
            self.agents = []
        return (
            self._seen(decision),
            dict.fromkeys(names, decision.reward),
            dict.fromkeys(names, decision.terminated),
            dict.fromkeys(names, decision.truncated),
            self._told(decision),
        )

    def render(self) -> None:
        """Do nothing; `option_coordinator.plots` draws the environment's trace."""

    def _seen(self, decision: Decision) -> dict[str, AgentDict]:
        out: dict[str, AgentDict] = {}
        for agent, legal, option in zip(decision.agents, decision.legal, decision.running, strict=True):
            every = np.arange(len(agent.options))
            mask = legal[: len(every)] if option == NONE else every == option
            out[agent.name] = {
                "observation": decision.observations[agent.name],
                "action_mask": mask.astype(np.int8),
            }
        return out

    def _told(self, decision: Decision) -> dict[str, dict[str, Any]]:
        shared = {"duration": decision.duration, "discount": decision.discount}
        return {name: {**shared, "ready": name in decision.ready} for name in self.possible_agents}

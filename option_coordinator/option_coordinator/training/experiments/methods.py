"""The methods compared in thesis 5.3: same trunk, observations and (with one exception) low-level samples."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

from option_coordinator.environments.option_env import Synchronisation
from option_coordinator.environments.tasks import Level
from option_coordinator.policies.policy_file import MOST_CELLS

_OF_THE_THESIS = ("tool_delivery", "water_filling")
"""Kinds of tasks in the thesis."""


@dataclass(frozen=True)
class Method:
    """A way to learn.

    Attributes:
        label: Name in tables and figures.
        synchronisation: Termination strategy.
        head: Kind of joint policy.
        partial: Whether each agent chooses from its own observation (Eq. 5.5).
        learner: "mappo" or "mac_dqn".
        level: Level of choice, an `option_coordinator.environments.tasks.Level`.
        budget: Low-level samples by kind of task, as a multiple of the other methods'; 1 for tasks not listed.
        kinds: Kinds of tasks for which the method is used.
    """

    label: str
    synchronisation: Synchronisation = "async"
    head: str = "table"
    partial: bool = False
    learner: Literal["mappo", "mac_dqn"] = "mappo"
    level: Level = "options"
    budget: Mapping[str, int] = field(default_factory=dict)
    kinds: tuple[str, ...] = (*_OF_THE_THESIS, "team_delivery")


_LONG = MappingProxyType({"tool_delivery": 8, "water_filling": 3})
"""Sample budget of Mac-DQN in Tables 5.2 and 5.3: 400K and 600K, versus 50K and 200K for the others."""
METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "async": Method("async (thesis)"),
        "async_autoregressive": Method("async, any-order autoregressive", head="autoregressive"),
        "async_mixture": Method("async, mixture of products", head="mixture"),
        "partial": Method("async, partially centralised", partial=True),
        "sync_cut": Method("sync-cut", "cut"),
        "sync_wait": Method("sync-wait", "wait"),
        "end2end": Method("end2end", level="actions", kinds=_OF_THE_THESIS),
        "mac_dqn": Method("Mac-DQN", learner="mac_dqn"),
        "mac_dqn_long": Method("Mac-DQN, thesis's samples", learner="mac_dqn", budget=_LONG, kinds=_OF_THE_THESIS),
        "async_thesis_options": Method("async, options of Table 5.1", level="thesis", kinds=("water_filling",)),
    }
)
"""All methods by name."""


def usual_methods(counts: Sequence[int]) -> tuple[str, ...]:
    """Return the methods to learn with if none are named, for agents with these numbers of options."""
    return ("async", "sync_wait") if math.prod(counts) <= MOST_CELLS else ("async_mixture",)

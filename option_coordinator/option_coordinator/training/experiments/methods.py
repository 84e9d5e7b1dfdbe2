"""What is compared in thesis 5.3: the same trunk, observations and, but for one, low-level samples; choice differs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

from option_coordinator.environments.option_env import Synchronisation
from option_coordinator.environments.tasks import Level

_OF_THE_THESIS = ("tool_delivery", "water_filling")
"""Kinds of tasks."""


@dataclass(frozen=True)
class Method:
    """A way to learn.

    Attributes:
        label: Name in tables and pictures.
        synchronisation: Rule of who chooses when.
        head: kind of joint policy.
        partial: whether each agent chooses by its own observation (Eq. 5.5).
        learner: "mappo" or "mac_dqn".
        level: Level of the choice, a `option_coordinator.environments.tasks.Level`.
        budget: low-level samples by kind of task, in those of the others; 1 for a task that is not named.
        kinds: Kinds of tasks that it is for.
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
"""Mac-DQN's in Tables 5.2 and 5.3: 400K and 600K, the others' 50K and 200K."""
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

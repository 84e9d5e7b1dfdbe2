"""What is compared in thesis 5.3: the same networks, observations and low-level samples, another way to choose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from option_coordinator.event_driven import Synchronisation


@dataclass(frozen=True)
class Method:
    """A way to learn.

    Attributes:
        label: for tables and pictures.
        synchronisation: who chooses when.
        head: kind of joint policy.
        partial: whether each agent chooses by its own observation (Eq. 5.5).
        learner: "mappo" or "mac_dqn".
        level: whether options are chosen, or a low-level action at each step.
    """

    label: str
    synchronisation: Synchronisation = "async"
    head: str = "table"
    partial: bool = False
    learner: Literal["mappo", "mac_dqn"] = "mappo"
    level: Literal["options", "actions"] = "options"


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "async": Method("async (thesis)"),
        "async_autoregressive": Method("async, any-order autoregressive", head="autoregressive"),
        "async_mixture": Method("async, mixture of products", head="mixture"),
        "partial": Method("async, partially centralised", partial=True),
        "sync_cut": Method("sync-cut", "cut"),
        "sync_wait": Method("sync-wait", "wait"),
        "end2end": Method("end2end", level="actions"),
        "mac_dqn": Method("Mac-DQN", learner="mac_dqn"),
    }
)
"""All methods by name."""

"""Why a request is refused: what a policy may not be shown, and what comes too late."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from option_coordinator.options.options import Agent
from option_coordinator.protocol.protocol_types import Request


class Refusal(NamedTuple):
    """Why.

    Attributes:
        kind: a word or two, to count by.
        reason: a sentence for the robot's log.
    """

    kind: str
    reason: str


def refusal_of(request: Request, agent: Agent, epoch: int, age: float, oldest: float) -> Refusal | None:
    """Return what is wrong with a request, None if nothing is.

    Args:
        request: of the agent.
        agent: what it can do.
        epoch: of the coordinator.
        age: of the observation [s].
        oldest: that an observation may be [s].
    """
    observation, legal = np.asarray(request.observation), np.asarray(request.legal)
    if 0 < request.coordinator_epoch < epoch:
        return Refusal("stale epoch", "that epoch is over: ask again in this one")
    if observation.shape != (agent.observation_size,):
        return Refusal("wrong size", f"observation has shape {observation.shape}, must be ({agent.observation_size},)")
    if not np.isfinite(observation).all() or not math.isfinite(request.option_reward):
        return Refusal("not finite", "not all numbers of observation and reward are finite")
    if legal.size not in (0, len(agent.options)) or (legal.size and not legal.any()):
        must = f"must be {len(agent.options)} with one legal at least, or none"
        return Refusal("legal options", f"{legal.size} legal options, {np.count_nonzero(legal)} of them true: {must}")
    if age > oldest:
        return Refusal("stale observation", f"the observation is {age:.2f} s old: observe and ask again")
    return None

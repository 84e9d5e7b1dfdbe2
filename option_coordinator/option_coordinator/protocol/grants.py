"""A coordinator's answers to requests: which are refused, and what grants and refusals say."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from option_coordinator.options.options import Agent
from option_coordinator.protocol.clock_reading import ClockReading
from option_coordinator.protocol.ledger import Entry
from option_coordinator.protocol.protocol_types import Grant, GrantStatus, Request
from option_coordinator.protocol.team_settings import RobotSpec

_TOO_LONG = "it takes longer than it may: ask again"


class Refusal(NamedTuple):
    """Reason of a refusal.

    Attributes:
        kind: Two or three words, the key of a counter.
        reason: Sentence for the robot's log.
    """

    kind: str
    reason: str


UNKNOWN_ROBOT = Refusal("unknown robot", "this team has no such robot")
TASK_OVER = Refusal("task over", "the task is over")
NOTHING_SAFE = Refusal("nothing safe", "policy failed, and the safe option is not legal")
NUMBER_LEAPS = Refusal("request number leaps", "request_id grows by one per request: so many cannot have been missed")


def refusal_of(request: Request, agent: Agent, epoch: int, age: float, oldest: float) -> Refusal | None:
    """Return why a request cannot be put to the policy, None if it can.

    Args:
        request: Request of the agent.
        agent: Options and observation size of the agent.
        epoch: Epoch of the coordinator, 0 while it listens.
        age: Age of the observation [s].
        oldest: Largest age of an observation [s].
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


def standing_grant(entry: Entry, robot: RobotSpec, epoch: int, team: str, now: ClockReading) -> Grant:
    """Return the answer that holds for a robot's latest request: its grant, or the cancellation of that.

    Args:
        entry: Ledger entry of the robot.
        robot: Options of the robot.
        epoch: Epoch of the coordinator.
        team: Name of the team.
        now: Time of a cancellation; a grant keeps the stamp and the epoch of its decision.
    """
    cancelled = entry.cancelled
    return Grant(
        stamp=now.stamp if cancelled else entry.stamp,
        agent=entry.agent,
        incarnation=entry.incarnation,
        request_id=entry.request_id,
        coordinator_epoch=epoch if cancelled else entry.epoch,
        grant_id=entry.grant_id,
        status=GrantStatus.CANCELLED if cancelled else GrantStatus.GRANTED,
        reason=_TOO_LONG if cancelled else "",
        option=entry.option,
        option_name=robot.agent.options[entry.option],
        deadline=robot.durations[entry.option],
        team=team,
    )


def refused_grant(request: Request, refusal: Refusal, epoch: int, team: str, now: ClockReading) -> Grant:
    """Return the refusal of a request, in a coordinator's epoch."""
    return Grant(
        stamp=now.stamp,
        agent=request.agent,
        incarnation=request.incarnation,
        request_id=request.request_id,
        coordinator_epoch=epoch,
        grant_id=0,
        status=GrantStatus.REFUSED,
        reason=refusal.reason,
        team=team,
    )

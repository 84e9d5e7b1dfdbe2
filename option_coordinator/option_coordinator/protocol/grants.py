"""Messages from a coordinator: grants and refusals for robots, and joint steps for the bag (thesis Definition 1)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from option_coordinator.options.options import Agent, PolicyQuery
from option_coordinator.policies.joint_policy import JointOptions
from option_coordinator.protocol.clock_reading import ClockReading
from option_coordinator.protocol.ledger import RobotState
from option_coordinator.protocol.protocol_types import Grant, GrantStatus, JointStep, Request, TeamId
from option_coordinator.protocol.team import RobotSpec


class Refusal(NamedTuple):
    """Reason of a refusal.

    Attributes:
        kind: Short reason, used as a counter key.
        reason: Full reason for the robot's log.
        work: Work that the robot must take over, see `WorkMemory`.
    """

    kind: str
    reason: str
    work: str = ""


UNKNOWN_ROBOT = Refusal("unknown robot", "this team has no such robot")
TASK_OVER = Refusal("task over", "the task is over")
NOTHING_SAFE = Refusal("nothing safe", "policy failed, and the safe option is not legal")
NUMBER_LEAPS = Refusal("request number leaps", "request_id grows by one per request: so many cannot have been missed")


def other_file(own: str, theirs: str) -> Refusal:
    """Return the refusal for a robot whose team file has other content: its options may have other indices."""
    digests = f"digest {theirs[:12]}, the coordinator's {own[:12]}"
    return Refusal("another team file", f"the robot's team file differs ({digests}): give both the same file")


def kept_work(work: str) -> Refusal:
    """Return the refusal for a robot that has restarted and does not know its work."""
    return Refusal("work kept", "the robot was at work before it restarted: it goes on from there", work)


def refusal_of(request: Request, agent: Agent, epoch: int, age: float, oldest: float) -> Refusal | None:
    """Return the refusal for a request that must not reach the policy, or None.

    Args:
        request: Request of the agent.
        agent: Options and observation size of the agent.
        epoch: Epoch of the coordinator; 0 while listening.
        age: Age of the observation [s].
        oldest: Maximum age of an observation [s].
    """
    observation, legal = np.asarray(request.observation), np.asarray(request.legal)
    if 0 < request.coordinator_epoch < epoch:
        return Refusal("stale epoch", "that epoch is over: send a new request in this one")
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


def standing_grant(entry: RobotState, robot: RobotSpec, epoch: int, team: TeamId, now: ClockReading) -> Grant:
    """Return the answer to a robot's latest request: its grant, or the cancellation.

    Args:
        entry: Ledger entry of the robot.
        robot: Options of the robot.
        epoch: Epoch of the coordinator.
        team: Name and digest of the team.
        now: Time of a cancellation; a grant keeps the stamp and epoch of its decision.
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
        reason=cancelled,
        option=entry.option,
        option_name=robot.agent.options[entry.option],
        deadline=robot.durations[entry.option],
        team=team.name,
        team_digest=team.digest,
    )


def refused_grant(request: Request, refusal: Refusal, epoch: int, team: TeamId, now: ClockReading) -> Grant:
    """Return the message that refuses a request."""
    return Grant(
        stamp=now.stamp,
        agent=request.agent,
        incarnation=request.incarnation,
        request_id=request.request_id,
        coordinator_epoch=epoch,
        grant_id=0,
        status=GrantStatus.REFUSED,
        reason=refusal.reason,
        team=team.name,
        team_digest=team.digest,
        work=refusal.work,
    )


class EpisodeRecorder:
    """Numbers the decisions of an episode and sums the reward between them.

    Args:
        now: Start time [s].
        time_step: Duration of a low-level step [s].
        discount: Discount factor gamma of a low-level step.

    Attributes:
        open: Whether an episode is in progress.
    """

    def __init__(self, now: float, time_step: float, discount: float) -> None:
        self._time_step, self._discount = time_step, discount
        self._number, self._reward, self._decided_at = 0, 0.0, now
        self.open = False

    def credit(self, reward: float, began: float, longest: float) -> bool:
        """Add the reward of an option that started at some time [s], discounted to the last decision.

        The joint rewards of an episode therefore add up to the rewards of its options. A reported start more than
        `longest` [s] before that decision is clipped. If the sum would overflow, nothing is added and the method
        returns False.
        """
        began = max(began, self._decided_at - longest)
        try:
            total = self._reward + self._discount ** round((began - self._decided_at) / self._time_step) * reward
        except OverflowError:
            return False
        if not math.isfinite(total):
            return False
        self._reward = total
        return True

    def step(
        self,
        now: ClockReading,
        epoch: int,
        asked: PolicyQuery,
        options: JointOptions,
        log_probability: float = 0.0,
        digest: str = "",
        terminated: bool = False,
        truncated: bool = False,
    ) -> JointStep:
        """Return the step of a decision (query, options from now on, policy), or an episode's last step."""
        self.open = not (terminated or truncated)
        out = JointStep(
            stamp=now.stamp,
            coordinator_epoch=epoch,
            step=self._number,
            policy_digest=digest,
            running=asked.running >= 0,
            absent=options < 0,
            options=options,
            legal=asked.legal,
            observation=asked.observation,
            log_probability=log_probability,
            reward=self._reward,
            duration=round((now.task - self._decided_at) / self._time_step),
            terminated=terminated,
            truncated=truncated,
        )
        self._number, self._reward, self._decided_at = self._number + 1, 0.0, now.task
        return out

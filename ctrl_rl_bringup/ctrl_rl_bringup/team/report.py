"""Report on a recorded team: the options that its robots ran, the outcome, the latency of grants."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.ros import seconds
from numpy.typing import NDArray
from option_coordinator.environments import Span
from option_coordinator.protocol import TASK_OVER, GrantStatus

from ctrl_rl_bags import BagError, bag_info, read_messages
from ctrl_rl_bringup.runner.transport import lost_messages, read_sent, recorded_parameters

Array = NDArray[np.float64]

_USED_UP = 0.98
_NO_TROUBLE = "no option overran, so the limit passed or the run was interrupted"
_SHARED = ("/option_requests", "/option_grants", "/joint_option_step")


@dataclass(frozen=True)
class TeamRun:
    """A team's run as recorded; times are seconds of simulation since the first decision.

    Attributes:
        agents: Names of the robots, in the policy's order.
        policy: Policy parameter of the coordinator.
        spans: Runs of options by robot and time.
        finished: Whether the team's work was done.
        duration: Time until the work was done, or until the recording ended [s].
        decisions: Number of joint steps.
        team_return: Undiscounted sum of the joint rewards.
        answers: Number of grants by status, and of refusals by reason.
        paths: True positions (n, 2) of each robot [m].
        clearance: Smallest clearance of any robot [m]; NaN if none was recorded.
        latencies: Time from a request's arrival at the recorder to its grant's [s of wall time].
        messages: Number of recorded messages.
        lost: Number of messages published while the recorder listened, but not recorded.
        idle: Names of options that do not count as work.
        troubles: Overruns and refusals of each robot, in words, which explain a run that was cut off.
    """

    agents: tuple[str, ...]
    policy: str
    spans: tuple[Span, ...]
    finished: bool
    duration: float
    decisions: int
    team_return: float
    answers: dict[str, int]
    paths: dict[str, Array]
    clearance: float
    latencies: Array
    messages: int
    lost: int
    idle: frozenset[str] = frozenset()
    troubles: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """How the run ended, and why it was cut off."""
        if self.finished:
            return "all work done"
        return f"cut off after {self.duration:.0f} s: {'; '.join(self.troubles) or _NO_TROUBLE}"

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as plain JSON values."""
        return {
            "finished": self.finished,
            "verdict": self.verdict,
            "policy": self.policy,
            "time_s": self.duration,
            "decisions": self.decisions,
            "return": self.team_return,
            "answers": self.answers,
            "options": dict(Counter(span.option for span in self.spans)),
            "busy": {agent: self.busy(agent) for agent in self.agents},
            "smallest_clearance_m": self.clearance if np.isfinite(self.clearance) else None,
            "grant_median_ms": 1e3 * float(np.median(self.latencies)) if len(self.latencies) else None,
            "messages_recorded": self.messages,
            "messages_lost": self.lost,
            "spans": [span._asdict() for span in self.spans],
        }

    def text(self) -> str:
        """Return the figures for people."""
        options = ", ".join(f"{count} {name}" for name, count in Counter(span.option for span in self.spans).items())
        answers = ", ".join(f"{count} {name}" for name, count in self.answers.items())
        busy = ", ".join(f"{agent} {100 * self.busy(agent):.0f} %" for agent in self.agents)
        latency = f"{1e3 * np.median(self.latencies):.1f} ms median" if len(self.latencies) else "none"
        return "\n".join(
            (
                f"outcome             {self.verdict}",
                f"policy              {self.policy}",
                f"time                {self.duration:.1f} s",
                f"decisions           {self.decisions}, return {self.team_return:.1f}",
                f"options             {options}",
                f"answers             {answers}; {latency}",
                f"at work             {busy}",
                f"smallest clearance  {self.clearance:.3f} m",
                f"messages            {self.messages} recorded, {self.lost} lost",
            )
        )

    def busy(self, agent: str) -> float:
        """Return the fraction of time in which a robot ran an option that counts as work."""
        work = [span for span in self.spans if span.agent == agent and span.option not in self.idle]
        return sum(span.end - span.begin for span in work) / max(self.duration, 1e-9)


def read_team(bag: Path, idle: Collection[str] = ()) -> TeamRun:
    """Read a team's run from a bag.

    Args:
        bag: Folder of the bag.
        idle: Names of options that do not count as work.

    Raises:
        BagError: The bag cannot be read, or has no decisions.
    """
    info = bag_info(bag)
    paths: dict[str, list[tuple[float, float]]] = defaultdict(list)
    said: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    clearances = [float("nan")]
    own = [topic for topic in info.topics if topic.rsplit("/", 1)[-1] in ("ground_truth", "episode")]
    for message in read_messages(bag, [*(topic for topic in _SHARED if topic in info.topics), *own]):
        if message.topic in _SHARED:
            said[message.topic].append((message.log_time, message.data))
        elif message.topic.endswith("/ground_truth"):
            place = message.data.pose.pose.position
            paths[message.topic.split("/")[1]].append((place.x, place.y))
        else:
            clearances.append(message.data.smallest_clearance)
    if not said["/joint_option_step"]:
        raise BagError(f"{bag}: holds no joint_option_step: was there a coordinator?")
    steps = [step for _, step in said["/joint_option_step"]]
    begin, end = seconds(steps[0].header.stamp), seconds(steps[-1].header.stamp)
    grants, requests = said["/option_grants"], said["/option_requests"]
    settings = recorded_parameters(info.custom_data, "option_coordinator")
    runs = spans(grants, requests, begin, end)
    return TeamRun(
        agents=tuple(steps[0].agents),
        policy=Path(str(settings.get("policy", "unknown"))).name
        + (f" ({steps[0].policy_digest[:12]})" if steps[0].policy_digest else ", not learnt"),
        spans=tuple(runs),
        finished=bool(steps[-1].terminated),
        duration=end - begin,
        decisions=len(steps),
        team_return=float(sum(step.reward for step in steps)),
        answers=dict(Counter(_answer(grant) for _, grant in grants)),
        paths={robot: np.array(points) for robot, points in paths.items()},
        clearance=float(np.nanmin(clearances)) if len(clearances) > 1 else float("nan"),
        latencies=_latencies(grants, requests),
        messages=info.message_count,
        lost=lost_messages(read_sent(bag)),
        idle=frozenset(idle),
        troubles=tuple(troubles([grant for _, grant in grants], runs)),
    )


def spans(grants: list[tuple[int, Any]], requests: list[tuple[int, Any]], begin: float, end: float) -> list[Span]:
    """Return who ran which option when: from its grant to that robot's next request, in seconds since `begin`."""
    ends: dict[tuple[str, int, int], float] = {}
    for _, request in requests:
        ends.setdefault((request.agent, request.incarnation, request.request_id), seconds(request.header.stamp))
    cancelled = {(g.agent, g.grant_id) for _, g in grants if g.status == GrantStatus.CANCELLED}
    out: dict[tuple[str, int], Span] = {}
    for _, grant in grants:
        if grant.status != GrantStatus.GRANTED or (grant.agent, grant.grant_id) in out:
            continue
        key = (grant.agent, grant.incarnation, grant.request_id + 1)
        finished = key in ends and (grant.agent, grant.grant_id) not in cancelled
        times = seconds(grant.header.stamp) - begin, ends.get(key, end) - begin
        out[grant.agent, grant.grant_id] = Span(grant.agent, grant.option_name, *times, finished)
    return list(out.values())


def troubles(grants: list[Any], runs: list[Span]) -> list[str]:
    """Return in words how often each robot exceeded an option's maximum duration, and why it was last refused."""
    limits = {(g.agent, g.option_name): g.deadline for g in grants if g.status == GrantStatus.GRANTED}
    long = [(r.agent, r.option) for r in runs if r.end - r.begin >= _USED_UP * limits[r.agent, r.option]]
    out = [
        f"{agent} exceeded the {limits[agent, option]:g} s of '{option}' {count} time{'s' * (count > 1)}"
        for (agent, option), count in Counter(long).items()
    ]
    refused = {g.agent: g.reason for g in grants if g.status == GrantStatus.REFUSED and g.reason != TASK_OVER.reason}
    return out + [reason if reason.startswith(agent) else f"{agent}: {reason}" for agent, reason in refused.items()]


def _answer(grant: Any) -> str:
    status = GrantStatus(grant.status)
    return f"refused ({grant.reason})" if status is GrantStatus.REFUSED else status.name.lower()


def _latencies(grants: list[tuple[int, Any]], requests: list[tuple[int, Any]]) -> Array:
    def first(messages: list[tuple[int, Any]]) -> dict[tuple[str, int, int], int]:
        return {(m.agent, m.incarnation, m.request_id): time for time, m in reversed(messages)}

    asked, answered = first(requests), first([pair for pair in grants if pair[1].status == GrantStatus.GRANTED])
    return 1e-9 * np.array([time - asked[key] for key, time in answered.items() if key in asked], dtype=float)

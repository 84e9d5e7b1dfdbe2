"""The coordinator node: receives requests and heartbeats, publishes grants and joint steps."""

from __future__ import annotations

import hashlib
import time
from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from ctrl_rl_core.ros import Status, ok, warn
from rclpy.duration import Duration

from ctrl_rl_core import Parameter, ParameterError, SuiteNode, run_node
from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, JointOptionStep, OptionGrant, OptionRequest
from option_coordinator.errors import OptionError
from option_coordinator.nodes.coordinator_parameters import PARAMETERS
from option_coordinator.nodes.messages import (
    EXCHANGE,
    StepMessages,
    grant_message,
    heartbeat_message,
    heartbeat_of,
    request_in,
    status_of,
)
from option_coordinator.nodes.option_agent import STEADY, Clocks, steady_time
from option_coordinator.nodes.work_board import open_board
from option_coordinator.options.options import PolicyQuery
from option_coordinator.policies.joint_policy import JointOptions
from option_coordinator.policies.policy_file import OptionPolicy
from option_coordinator.policies.policy_query import PolicyFn, learned_policy_fn
from option_coordinator.protocol.clock_reading import ClockReading
from option_coordinator.protocol.coordination import Coordinator
from option_coordinator.protocol.protocol_types import LONGEST_NAME, Answers, MessageError, Request, TeamId
from option_coordinator.protocol.replica import LATE
from option_coordinator.protocol.team import CoordinatorTimeouts, RobotSpec
from option_coordinator.protocol.work_memory import WorkMemory
from option_coordinator.scripted.policy_queries import SCRIPTED, spread_policy, uniform_policy
from option_coordinator.teams.loading import load_team
from option_coordinator.teams.team_file import TeamFile

_Take = Callable[[Any, ClockReading], Answers]
_HOUSEKEEPING_S = 0.02
_LAST_WORD = Duration(seconds=0.3)
_SAID_EVERY_S = 10.0
_FINE = (
    "duplicate requests",
    "policies replaced",
    "adopted grants",
    "returned robots",
    "words of other teams",
    "messages of other teams",
    "refused: work kept",
)
"""Counters of events that are not errors."""


class OptionCoordinator(SuiteNode):
    """Grants options to robots on request, as soon as they are ready; no robot waits for another one.

    Subscribes to option_requests and agent_status; publishes option_grants, and a joint_option_step for each decision,
    for training from bags. The policy can be replaced at run time, starting with the next decision. Several
    coordinators monitor each other through coordinator_status: one decides, the others stand by.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = PARAMETERS
    SHARED_MEMORY = False  # a frozen or killed robot would block the service

    def __init__(self) -> None:
        super().__init__("option_coordinator")
        timeouts, discount = self._prepare()
        self._policy_times: deque[float] = deque(maxlen=1000)
        self._reported: Counter[str] = Counter()
        self._now = Clocks(self)
        self._began = False
        self._held_up = LATE * timeouts.lease
        self._board = open_board(self, self._team, self._team_name(), lambda: self._now().stamp)
        chooses, digest = self._chooser()
        begin, team = ClockReading(0.0, 0.0, 0.0), TeamId(self._team_name(), self._team.digest if self._team else "")
        kept = self.settings["memory"] or self.settings["work"]
        memory = WorkMemory(Path(kept) if kept else None, team.name)
        self._coordinator = Coordinator(
            self._robots, chooses, digest, begin, timeouts, discount=discount, team=team, memory=memory
        )
        self._step_message = StepMessages(tuple(robot.agent for robot in self._robots), discount, timeouts.time_step)
        self._grants = self.create_publisher(OptionGrant, "option_grants", EXCHANGE)
        self._steps = self.create_publisher(JointOptionStep, "joint_option_step", EXCHANGE)
        self._heartbeats = self.create_publisher(CoordinatorStatus, "coordinator_status", EXCHANGE)
        # As bytes, so that an oversized message is rejected before its slow deserialisation.
        hears = partial(self._on_message, request_in, self._on_request)
        self.create_subscription(OptionRequest, "option_requests", hears, EXCHANGE, raw=True)
        hears = partial(self._on_message, status_of, self._coordinator.on_status)
        self.create_subscription(AgentStatus, "agent_status", hears, EXCHANGE)
        hears = partial(self._on_message, heartbeat_of, self._coordinator.on_coordinator_heartbeat)
        self.create_subscription(CoordinatorStatus, "coordinator_status", hears, EXCHANGE)
        self._batch_ends = False
        self._window = self.create_timer(max(timeouts.batch_window, 1e-4), self._end_batch, clock=STEADY)
        self._window.cancel()
        self.create_timer(_HOUSEKEEPING_S, partial(self._work, self._coordinator.tick), clock=STEADY)
        if self._board is not None:
            self._board.follow(self._coordinator)
        of_team = f"{len(self._robots)} robots of team '{self._coordinator.team.name}'"
        self.get_logger().info(f"policy {self._policy_name(digest)}, {of_team}")

    def on_parameter_changed(self, name: str) -> None:
        """Use another policy for all further decisions."""
        if name == "policy":
            chooses, digest = self._chooser()
            self._coordinator.replace_policy(chooses, digest)
            self.get_logger().info(f"policy {self._policy_name(digest)} from now on")

    def status(self) -> Status:
        """Report whether this coordinator decides, the states of the robots, and the faults."""
        coordinator, counts = self._coordinator, self._coordinator.counts
        new = counts - self._reported
        self._reported = counts.copy()
        states = Counter(str(entry.state) for entry in coordinator.ledger.values())
        figures: dict[str, object] = {"epoch": coordinator.epoch, "policy": coordinator.digest or "scripted"}
        figures |= {"team": coordinator.team.name, "clock set": self._now.task.jumps}
        figures |= {"epochs not believed": coordinator.epochs_not_believed}
        figures |= self._board.figures if self._board is not None else {}
        figures |= {f"robots {state}": count for state, count in states.items()} | dict(counts)
        if self._policy_times:
            p50, p99 = np.percentile(self._policy_times, (50, 99)) * 1e3
            figures |= {"policy p50 [ms]": f"{p50:.3f}", "policy p99 [ms]": f"{p99:.3f}"}
        faults = [entry.given_up for entry in coordinator.ledger.values() if entry.given_up]
        faults += [f"{count} {kind}" for kind, count in new.items() if kind not in _FINE]
        if coordinator.stands_by:
            return ok("another coordinator decides", **figures)
        if not coordinator.epoch:
            unheard = ", ".join(coordinator.unheard)
            return ok(f"listening, not heard yet: {unheard}" if unheard else "listening", **figures)
        if len(coordinator.unheard) == len(self._robots):
            faults.append("hears no robot")
        return warn(", ".join(faults), **figures) if faults else ok("deciding", **figures)

    def stop(self) -> None:
        """Close the recorded episode; its last step is delivered before the publisher closes."""
        self._work(self._coordinator.close)
        self._steps.wait_for_all_acked(_LAST_WORD)
        if self._board is not None:
            self._board.tell()

    def _prepare(self) -> tuple[CoordinatorTimeouts, float]:
        """Set up the team's robots, and return timeouts and discount."""
        settings = self.settings
        if settings["lost_after"] < settings["lease"]:
            raise ParameterError("parameter 'lost_after' is less than 'lease': a robot is suspect before it is lost")
        step, discount = settings["step_length"], settings["discount"]
        self._team: TeamFile | None = None
        if settings["team"]:
            team = load_team(settings["team"])
            self._team, self._robots = team, team.coordinated
            step, discount = team.time_step, team.discount
        elif settings["policy"] in SCRIPTED:
            raise ParameterError(
                "parameter 'team' is missing: a scripted policy needs a team file that names the robots"
            )
        else:
            longest, safe = settings["longest_option"], settings["safe_option"]
            agents = OptionPolicy.load(settings["policy"]).agents
            self._robots = tuple(RobotSpec(agent, (longest,) * len(agent.options), safe) for agent in agents)
        names = ("batch_window", "lease", "lost_after", "repeat", "stale", "policy_limit", "most_overruns")
        timeouts = CoordinatorTimeouts(time_step=step, **{name: settings[name] for name in names})
        return timeouts, discount

    def _chooser(self) -> tuple[PolicyFn, str]:
        """Load a policy and return it with its digest.

        Raises:
            OptionError: The policy does not exist, its digest differs from the expected one, or it belongs to another
                team.
        """
        name, generator = self.settings["policy"], np.random.default_rng(self.settings["seed"])
        if self._board is not None:
            if name != "spread":
                raise OptionError("parameter 'work' assigns the tasks that arrive: leave out 'policy'")
            return self._timed(self._board.dispatcher), ""
        if name == "uniform":
            return self._timed(uniform_policy(generator)), ""
        if name == "spread":
            if self._team is None:
                raise OptionError("policy 'spread' needs a team file, with the places of its stations: give 'team'")
            return self._timed(spread_policy(self._team)), ""
        policy = OptionPolicy.load_for(name, (robot.agent for robot in self._robots))
        promised = self.settings["policy_digest"]
        if promised and policy.digest != promised:
            raise OptionError(f"{name}: its digest is {policy.digest[:12]}, 'policy_digest' wants {promised[:12]}")
        return self._timed(learned_policy_fn(policy, generator)), policy.digest

    def _timed(self, chooses: PolicyFn) -> PolicyFn:
        def timed(choice: PolicyQuery) -> tuple[JointOptions, float]:
            begin = time.perf_counter()
            try:
                return chooses(choice)
            finally:
                self._policy_times.append(time.perf_counter() - begin)

        return timed

    def _on_message(self, read: Callable[[Any], Any], take: _Take, message: Any) -> None:
        """Handle a message; count rejected messages, and log them at a limited rate."""
        try:
            content = read(message)
        except MessageError as error:
            self._coordinator.counts[f"not taken: {error.kind}"] += 1
            self.get_logger().warning(f"a message is refused: {error}", throttle_duration_sec=_SAID_EVERY_S)
            return
        self._work(partial(take, content))

    def _on_request(self, request: Request, now: ClockReading) -> Answers:
        answers = self._coordinator.on_request(request, now)
        if self._coordinator.batches and not self._batch_ends:
            self._begin_batch()
        return answers

    def _begin_batch(self) -> None:
        """Schedule one decision for all requests that arrive within the batch window."""
        self._batch_ends = True
        if self.settings["batch_window"] > 0.0:
            self._window.reset()
        else:
            self.call_soon(self._end_batch)

    def _end_batch(self) -> None:
        self._window.cancel()
        self._batch_ends = False
        self._work(self._coordinator.end_batch)

    def _work(self, work: Callable[[ClockReading], Answers]) -> None:
        """Run the coordinator, once it is listening, and send its answers."""
        if self._listens():
            now = self._now()
            self._send(work(now), now)

    def _send(self, answers: Answers, decided: ClockReading) -> None:
        """Publish answers; grants delayed since their decision are sent again later if still valid."""
        for grant in answers.grants:
            if steady_time() - decided.steady > self._held_up:
                self._coordinator.counts["grants held up"] += 1
                break
            self._grants.publish(grant_message(grant))
        for step in answers.steps:
            self._steps.publish(self._step_message(step))
        if answers.heartbeat is not None:
            self._heartbeats.publish(heartbeat_message(answers.heartbeat, decided.stamp))

    def _listens(self) -> bool:
        """Return whether the ROS clock has started; only then does the coordinator start to listen for a lease."""
        if not self._began and (now := self._now()).stamp > 0.0:
            self._coordinator.listen(now)
            self._began = True
        return self._began

    def _team_name(self) -> str:
        """Return the given team name, that of the team file, or the one shared by all policies of the robots."""
        given: str = self.settings["team_name"]
        if len(given) > LONGEST_NAME:
            raise ParameterError(f"parameter 'team_name' has {len(given)} characters: must be at most {LONGEST_NAME}")
        if given or self.settings["team"]:
            return given or Path(self.settings["team"]).stem
        robots = repr([(robot.agent.name, robot.agent.options) for robot in self._robots])
        return f"robots-{hashlib.sha256(robots.encode()).hexdigest()[:8]}"

    def _policy_name(self, digest: str) -> str:
        name = self.settings["policy"]
        return f"{Path(name).name} ({digest[:12]})" if digest else f"'{name}'"


def main() -> int:
    """Run the node."""
    return run_node(OptionCoordinator)

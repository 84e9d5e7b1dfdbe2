"""Simulated team under coordinators: conforming robots on a network that drops, delays and duplicates messages."""

import heapq
from dataclasses import replace
from functools import cache
from itertools import count

import numpy as np
from option_coordinator.protocol.protocol_types import AgentState, Answers, CoordinatorHeartbeat, GrantStatus

from option_coordinator import (
    Agent,
    AgentObservation,
    ClientTimeouts,
    ClockReading,
    Coordinator,
    CoordinatorTimeouts,
    Grant,
    OptionClient,
    OptionResult,
    Request,
    RobotSpec,
    Status,
)

TIMES = CoordinatorTimeouts(batch_window=0.01, most_overruns=0)  # a tenth of the options has no end
STEP = 0.04  # s, of the simulation
TIMEOUTS = ClientTimeouts(waiting=1.0)
LONGEST_DELAY = 0.4
AGENTS = [RobotSpec(Agent(f"r{i}", tuple("abc"[: 2 + i % 2]), 2), (2.0,) * (2 + i % 2)) for i in range(4)]
INCARNATIONS = count(100)


def uniform(seed):
    generator = np.random.default_rng(seed)

    def chooses(choice):
        options = choice.running.copy()
        for agent in np.flatnonzero(choice.choosing):
            options[agent] = generator.choice(np.flatnonzero(choice.legal[agent]))
        return options, -1.0

    return chooses


@cache
def at(seconds):
    """Time at which all clocks agree."""
    return ClockReading(seconds, seconds, seconds)


class SimulatedCoordinator:
    """Real coordinator with a queue of received messages."""

    def __init__(self, now, seed):
        self.core = Coordinator(AGENTS, uniform(seed), "digest", at(now), TIMES, seed)
        self.frozen = False
        self.inbox = []

    def take(self, message, now):
        """Process one message."""
        if isinstance(message, Request):
            return self.core.on_request(message, at(now))
        if isinstance(message, Status):
            return self.core.on_status(message, at(now))
        self.core.on_coordinator_heartbeat(message, at(now))
        return Answers()


class SimulatedRobot:
    """Robot side of the real protocol, with options of arbitrary duration."""

    def __init__(self, robot, random):
        self.robot, self.random = robot, random
        self.start(0.0)

    def start(self, now):
        """Start a new life, with all earlier state forgotten."""
        self.alive, self.frozen = True, False
        self.inbox = []
        self.running = None
        self.accepted = set()
        names = self.robot.agent.options
        self.client = OptionClient(self.robot.agent.name, names, self, next(INCARNATIONS), timeouts=TIMEOUTS)
        self.ask(now)

    def ask(self, now):
        self.asked_at = now
        self.client.ask(at(now))

    def observe(self):
        size = len(self.robot.durations)
        self.legal = self.random.random(size) < 0.5
        self.legal[self.random.integers(size)] = True
        return AgentObservation(np.zeros(2, np.float32), self.legal)

    def begin(self, option):
        assert self.running is None, "two options at once"
        assert self.legal[option] or self.client.state is AgentState.FALLBACK
        if self.client.state is AgentState.RUNNING:
            assert self.client.request_id not in self.accepted, "two grants of one request"
            self.accepted.add(self.client.request_id)
        self.running = option
        self.lasts = np.inf if self.random.random() < 0.1 else self.random.uniform(0.05, 1.5)

    def leave(self):
        self.running = None
        return OptionResult()

    def words(self, now):
        """Messages that the robot sends at present."""
        if not self.alive or self.frozen:
            return []
        request_id = self.client.request_id
        for grant in self.inbox:
            if isinstance(grant, CoordinatorHeartbeat):
                self.client.on_coordinator_heartbeat(grant, at(now))
                continue
            state = self.client.state
            self.client.on_grant(grant, at(now))
            if state is not AgentState.RUNNING and self.client.state is AgentState.RUNNING:
                self.began, self.ends = now, now + self.lasts
        self.inbox = []
        self.client.tick(at(now))
        if self.client.state is AgentState.RUNNING and now >= self.ends:
            self.running = None
            self.client.ended(at(now))
        if self.client.request_id != request_id:
            self.asked_at = now
        return self.client.due_messages(at(now))


class Team:
    """Robots, coordinators and the network between them."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.now = 0.0
        self.loss = self.double = self.delay = 0.0
        self.robots = {r.agent.name: SimulatedRobot(r, np.random.default_rng([seed, i])) for i, r in enumerate(AGENTS)}
        self.gone = {}
        self.coordinators = []
        self.under_way = []
        self.order = count()
        self.sent = {}  # of each coordinator: request -> its only grant
        self.requests = {}
        self.events = 0
        self.start_coordinator()

    def start_coordinator(self):
        self.coordinators.append(SimulatedCoordinator(self.now, int(self.random.integers(2**32))))

    def send(self, message, sender=None):
        self.events += 1
        if self.random.random() < self.loss:
            return
        for _ in range(1 + (self.random.random() < self.double)):
            at = self.now + 1e-4 + self.delay * self.random.random()
            heapq.heappush(self.under_way, (at, next(self.order), message, sender))

    def post(self, coordinator, answers):
        for grant in answers.grants:
            self.check_grant(coordinator, grant)
            self.send(grant)
        for step in answers.steps:
            self.check_step(step)
        if answers.heartbeat:
            self.send(answers.heartbeat)

    def check_grant(self, coordinator, grant):
        if grant.status is not GrantStatus.GRANTED:
            assert grant.reason
            return
        key = (id(coordinator), grant.coordinator_epoch, grant.agent, grant.incarnation, grant.request_id)
        what = (grant.grant_id, grant.option)
        assert self.sent.setdefault(key, what) == what, "one request, two grants"
        asked = self.requests.get((grant.agent, grant.incarnation, grant.request_id))
        assert asked is None or asked.legal[grant.option], "an illegal option"  # None: not this robot's own request

    def check_step(self, step):
        assert not np.any(step.running & step.absent)
        assert np.array_equal(step.options < 0, step.absent)
        for index, name in enumerate(self.robots):
            if name in self.gone and self.now > self.gone[name] + TIMES.lost_after + LONGEST_DELAY + 2 * STEP:
                assert not step.running[index], "a dead robot is still counted on"

    def deliver(self):
        while self.under_way and self.under_way[0][0] <= self.now:
            message = heapq.heappop(self.under_way)[2]
            if isinstance(message, Grant):
                robot = self.robots[message.agent]
                if robot.alive:
                    robot.inbox.append(message)
                continue
            if isinstance(message, CoordinatorHeartbeat):
                for robot in self.robots.values():
                    if robot.alive:
                        robot.inbox.append(message)
            for coordinator in self.coordinators:
                coordinator.inbox.append(message)

    def advance(self, seconds):
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            for robot in self.robots.values():
                for word in robot.words(self.now):
                    if isinstance(word, Request):
                        self.requests[word.agent, word.incarnation, word.request_id] = replace(word)
                    self.send(word)
            self.deliver()
            for coordinator in self.coordinators:
                if coordinator.frozen:
                    continue
                self.post(coordinator, coordinator.core.tick(at(self.now)))  # who was frozen ticks before it hears
                for message in coordinator.inbox:
                    self.post(coordinator, coordinator.take(message, self.now))
                coordinator.inbox.clear()

    def kill(self, name):
        self.robots[name].alive = False
        self.gone.setdefault(name, self.now)

    def freeze(self, name):
        if self.robots[name].alive:
            self.robots[name].frozen = True
            self.gone.setdefault(name, self.now)

    def thaw(self, name):
        if self.robots[name].alive:
            self.robots[name].frozen = False
            self.gone.pop(name, None)

    def restart(self, name):
        self.robots[name].start(self.now)
        self.gone.pop(name, None)

    def settle(self):
        """With a good network, one coordinator decides and every live robot is served, regardless of the others."""
        self.loss = self.double = self.delay = 0.0
        if not self.coordinators:
            self.start_coordinator()
        for coordinator in self.coordinators:
            coordinator.frozen = False
        self.advance(3.0)
        epochs = [coordinator.core.epoch for coordinator in self.coordinators]
        self.advance(3.0)
        assert [coordinator.core.epoch for coordinator in self.coordinators] == epochs
        (coordinator,) = (coordinator.core for coordinator in self.coordinators if coordinator.core.epoch)
        for name, robot in self.robots.items():
            entry = coordinator.ledger[name]
            if name in self.gone:
                assert not entry.runs
                continue
            client = robot.client
            runs = client.state is AgentState.RUNNING
            assert runs or self.now - robot.asked_at < 0.3, "a request without an answer"
            if runs and self.now - robot.began > 0.3:
                held = (entry.incarnation, entry.request_id, entry.grant_id, entry.option, entry.epoch)
                grant = client.grant
                assert grant.option == robot.running
                assert held == (
                    client.incarnation,
                    client.request_id,
                    grant.grant_id,
                    grant.option,
                    grant.coordinator_epoch,
                )

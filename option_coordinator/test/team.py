"""A simulated team under coordinators: robots as they should behave, on a network that loses, delays and doubles."""

import heapq
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from option_coordinator.coordination import Coordinator
from option_coordinator.exchange import AgentState, Grant, GrantStatus, JointStep, Request, Status
from option_coordinator.options import Agent
from option_coordinator.robot import Robot, Times

TIMES = Times(window=0.01)
STEP = 0.02  # s, of the simulation
BEAT = 0.1
LONGEST_DELAY = 0.4
AGENTS = [Robot(Agent(f"r{i}", tuple("abc"[: 2 + i % 2]), 2), (2.0,) * (2 + i % 2)) for i in range(4)]
INCARNATIONS = count(100)


def uniform(seed):
    generator = np.random.default_rng(seed)

    def chooses(choice):
        options = choice.running.copy()
        for agent in np.flatnonzero(choice.choosing):
            options[agent] = generator.choice(np.flatnonzero(choice.legal[agent]))
        return options, -1.0

    return chooses


@dataclass
class SimulatedRobot:
    robot: Robot
    random: np.random.Generator
    alive: bool = True
    frozen: bool = False

    def __post_init__(self):
        self.epoch = 0
        self.start(0.0)

    def start(self, now):
        """A new life: what it has seen is forgotten."""
        self.alive, self.frozen, self.epoch = True, False, 0
        self.incarnation = next(INCARNATIONS)
        self.request_id = self.grant_id = self.option = 0
        self.grant_epoch = 0
        self.began = now
        self.next_word = now
        self.inbox = []
        self.ask(now)

    def ask(self, now):
        self.state = AgentState.WAITING
        self.asked_at = now
        self.request_id += 1
        size = len(self.robot.durations)
        self.legal = self.random.random(size) < 0.5
        self.legal[self.random.integers(size)] = True
        self.observe(now)

    def observe(self, now):
        self.stamp = now
        self.next_word = now

    def words(self, now):
        """What it says at this moment."""
        if not self.alive or self.frozen:
            return
        for grant in self.inbox:
            self.take(grant, now)
        self.inbox = []
        if self.state is AgentState.RUNNING and now >= self.ends:
            self.ask(now)
        if now < self.next_word:
            return
        self.next_word = now + BEAT
        if self.state is AgentState.WAITING:
            yield self.request()
        yield self.status(now)

    def request(self):
        name, observation = self.robot.agent.name, np.zeros(2, np.float32)
        return Request(self.stamp, name, self.incarnation, self.request_id, self.epoch, observation, self.legal)

    def status(self, now):
        running = self.state is AgentState.RUNNING
        return Status(
            self.robot.agent.name,
            self.incarnation,
            self.state,
            self.grant_epoch if running else self.epoch,
            self.request_id,
            self.grant_id,
            self.option,
            now - self.began if running else 0.0,
        )

    def take(self, grant, now):
        if grant.incarnation != self.incarnation or grant.coordinator_epoch < self.epoch:
            return
        self.epoch = grant.coordinator_epoch
        if grant.request_id != self.request_id:
            return
        waiting = self.state is AgentState.WAITING
        if grant.status is GrantStatus.GRANTED and waiting:
            assert self.legal[grant.option]
            self.state, self.began = AgentState.RUNNING, now
            self.option, self.grant_id, self.grant_epoch = grant.option, grant.grant_id, grant.coordinator_epoch
            hangs = self.random.random() < 0.1
            self.ends = np.inf if hangs else now + self.random.uniform(0.05, 1.5)
        elif grant.status is GrantStatus.GRANTED and grant.coordinator_epoch == self.grant_epoch:
            assert (grant.grant_id, grant.option) == (self.grant_id, self.option)
        elif grant.status is GrantStatus.CANCELLED and (waiting or grant.grant_id == self.grant_id):
            self.ask(now)
        elif grant.status is GrantStatus.REFUSED and waiting:
            self.observe(now)


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
        seed = int(self.random.integers(2**32))
        self.coordinators.append(Coordinator(AGENTS, uniform(seed), "digest", self.now, TIMES, seed))

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
            self.send(step)

    def check_grant(self, coordinator, grant):
        if grant.status is not GrantStatus.GRANTED:
            assert grant.reason
            return
        key = (id(coordinator), grant.coordinator_epoch, grant.agent, grant.incarnation, grant.request_id)
        what = (grant.grant_id, grant.option)
        assert self.sent.setdefault(key, what) == what, "one request, two grants"
        asked = self.requests[grant.agent, grant.incarnation, grant.request_id]
        assert asked.legal[grant.option], "an illegal option"

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
            for coordinator in self.coordinators:
                if isinstance(message, Request):
                    self.post(coordinator, coordinator.on_request(message, self.now))
                elif isinstance(message, Status):
                    self.post(coordinator, coordinator.on_status(message, self.now))
                elif isinstance(message, JointStep):
                    coordinator.on_epoch(message.coordinator_epoch)

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
                self.post(coordinator, coordinator.tick(self.now, alone=len(self.coordinators) == 1))

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
        """With a good network and one coordinator, everybody who lives is served, whoever does not."""
        self.loss = self.double = self.delay = 0.0
        if not self.coordinators:
            self.start_coordinator()
        del self.coordinators[:-1]
        self.advance(4.0)
        (coordinator,) = self.coordinators
        assert coordinator.epoch > 0
        for name, robot in self.robots.items():
            entry = coordinator.ledger[name]
            if name in self.gone:
                assert not entry.runs
                continue
            assert robot.state is AgentState.RUNNING or self.now - robot.asked_at < 0.3, "a request without an answer"
            if robot.state is AgentState.RUNNING and self.now - robot.began > 0.3:
                held = (entry.incarnation, entry.request_id, entry.grant_id, entry.option, entry.epoch)
                runs = (robot.incarnation, robot.request_id, robot.grant_id, robot.option, robot.grant_epoch)
                assert held == runs

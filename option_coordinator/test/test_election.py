"""Exactly one of any number of coordinators decides, despite starts, ends, freezes, losses and delays."""

import heapq
from itertools import count

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule
from option_coordinator.protocol.election import Election

LEASE = 0.5
STEP = 0.02
DELAY = 0.1  # s, of a good network
AT_MOST = 4


class Network:
    """Elections connected by a network with losses and delays, each ticking at its own times."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.now, self.loss, self.delay = 0.0, 0.0, DELAY
        self.alive, self.frozen = {}, set()
        self.under_way, self.order = [], count()

    def start(self):
        name = next(self.order)
        self.alive[name] = Election(self.now, LEASE, int(self.random.integers(2**32)))

    def advance(self, seconds):
        end = self.now + seconds
        while self.now < end:
            self.now += STEP
            names = [name for name in self.alive if name not in self.frozen]
            self.random.shuffle(names)
            for name in names:
                if self.alive[name].tick(self.now):
                    self.say(self.alive[name].epoch)
            self.deliver()

    def say(self, epoch):
        for name in self.alive:
            if self.random.random() >= self.loss:
                at = self.now + self.delay * self.random.random()
                heapq.heappush(self.under_way, (at, next(self.order), name, epoch))

    def deliver(self):
        held = []
        while self.under_way and self.under_way[0][0] <= self.now:
            message = heapq.heappop(self.under_way)
            if message[2] in self.frozen:
                held.append(message)
            elif message[2] in self.alive:
                self.alive[message[2]].on_coordinator_heartbeat(message[3], self.now)
        for message in held:
            heapq.heappush(self.under_way, message)

    def deciding(self):
        return {name: e.epoch for name, e in self.alive.items() if e.epoch and name not in self.frozen}

    def check(self):
        """On a good network, one coordinator decides within just over a lease and remains; the others stand by."""
        self.loss, self.delay = 0.0, DELAY
        self.advance(4 * LEASE)  # what is under way from bad times may be as late as two leases
        one = self.deciding()
        assert len(one) == (len(self.alive) > len(self.frozen))
        for _ in range(20):
            self.advance(LEASE / 4)
            assert self.deciding() == one
        assert all(e.stands_by for name, e in self.alive.items() if name not in one and name not in self.frozen)


class Elections(RuleBasedStateMachine):
    @initialize(seed=st.integers(0, 2**32 - 1), many=st.integers(1, AT_MOST))
    def begin(self, seed, many):
        self.network = Network(seed)
        for _ in range(many):
            self.network.start()

    def one_of(self, which):
        return list(self.network.alive)[which % len(self.network.alive)]

    @rule(seconds=st.sampled_from([0.02, 0.1, 0.45, 0.6, 2.0]))
    def advance(self, seconds):
        self.network.advance(seconds)

    @precondition(lambda self: len(self.network.alive) < AT_MOST)
    @rule()
    def start(self):
        self.network.start()

    @precondition(lambda self: self.network.alive)
    @rule(which=st.integers(0, AT_MOST))
    def kill(self, which):
        name = self.one_of(which)
        del self.network.alive[name]
        self.network.frozen.discard(name)

    @precondition(lambda self: self.network.alive)
    @rule(which=st.integers(0, AT_MOST))
    def freeze_or_thaw(self, which):
        self.network.frozen ^= {self.one_of(which)}

    @precondition(lambda self: self.network.alive)
    @rule(which=st.integers(0, AT_MOST), ahead=st.integers(0, 3 << 32))
    def a_robot_has_seen_more(self, which, ahead):
        election = self.network.alive[self.one_of(which)]
        election.on_epoch(election.epoch + ahead, self.network.now)

    @rule(loss=st.sampled_from([0.0, 0.5, 1.0]), delay=st.sampled_from([0.0, DELAY, 2 * LEASE]))
    def worsen(self, loss, delay):
        self.network.loss, self.network.delay = loss, delay

    @rule()
    def check(self):
        self.network.check()

    def teardown(self):
        if hasattr(self, "network"):
            self.network.check()


TestElections = Elections.TestCase
TestElections.settings = settings(max_examples=200, stateful_step_count=30, deadline=None, derandomize=True)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), many=st.integers(1, AT_MOST))
def test_of_many_that_begin_at_once_one_decides_after_a_lease_and_is_replaced_after_another(seed, many):
    network = Network(seed)
    for _ in range(many):
        network.start()
    for _ in range(many):
        network.advance(LEASE + 2 * DELAY)
        assert len(network.deciding()) == 1
        (first,) = network.deciding()
        del network.alive[first]
    network.advance(LEASE)
    assert not network.deciding()


def test_who_comes_later_stands_by_and_is_above_whom_it_replaces():
    first, second = Election(0.0, LEASE, 0), Election(0.0, LEASE, 1)
    assert first.tick(LEASE)
    second.on_coordinator_heartbeat(first.epoch, 0.9 * LEASE)
    assert not second.tick(1.8 * LEASE)
    assert second.stands_by
    assert second.tick(1.9 * LEASE)
    assert second.epoch > first.epoch
    assert first.on_coordinator_heartbeat(second.epoch, 2.0 * LEASE)
    assert (first.epoch, first.stands_by) == (0, True)


def test_nobody_stands_by_for_one_that_robots_do_not_obey():
    deaf, other = Election(0.0, LEASE, 0), Election(0.0, LEASE, 1)
    deaf.tick(LEASE)
    other.on_epoch(deaf.epoch + 1, 0.0)
    other.on_coordinator_heartbeat(deaf.epoch, LEASE)
    assert not other.stands_by
    assert other.tick(LEASE)
    assert other.epoch > deaf.epoch + 1


@pytest.mark.parametrize("epoch", [2**64 - 1, 1 << 62])
def test_an_epoch_that_counting_cannot_reach_is_ignored(epoch):
    election = Election(0.0, LEASE, 0)
    election.tick(LEASE)
    own = election.epoch
    assert not election.on_coordinator_heartbeat(epoch, LEASE)
    assert not election.on_epoch(epoch, LEASE)
    assert (election.epoch, own < 1 << 62) == (own, True)

"""Thousands of kills, freezes, restarts, losses, duplicates and delays: no double grant, no endless wait."""

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule
from team import AGENTS, LONGEST_DELAY, Team

COORDINATORS = 3
WHICH = st.integers(0, COORDINATORS - 1)
NAMES = st.sampled_from([robot.agent.name for robot in AGENTS])


class Faults(RuleBasedStateMachine):
    @initialize(seed=st.integers(0, 2**32 - 1))
    def begin(self, seed):
        self.team = Team(seed)

    @rule(seconds=st.sampled_from([0.1, 0.3, 0.7, 2.5]))
    def advance(self, seconds):
        self.team.advance(seconds)

    @rule(name=NAMES)
    def kill(self, name):
        self.team.kill(name)

    @rule(name=NAMES)
    def freeze(self, name):
        self.team.freeze(name)

    @rule(name=NAMES)
    def thaw(self, name):
        self.team.thaw(name)

    @rule(name=NAMES)
    def restart(self, name):
        self.team.restart(name)

    @rule(which=WHICH)
    def kill_coordinator(self, which):
        del self.team.coordinators[which : which + 1]

    @rule(which=WHICH, frozen=st.booleans())
    def freeze_coordinator(self, which, frozen):
        for coordinator in self.team.coordinators[which : which + 1]:
            coordinator.frozen = frozen

    @rule()
    def start_coordinator(self):
        if len(self.team.coordinators) < COORDINATORS:
            self.team.start_coordinator()

    @rule(
        loss=st.sampled_from([0.0, 0.3]),
        double=st.sampled_from([0.0, 0.3]),
        delay=st.sampled_from([0.0, 0.05, LONGEST_DELAY]),
    )
    def network(self, loss, double, delay):
        self.team.loss, self.team.double, self.team.delay = loss, double, delay

    @rule()
    def settle(self):
        self.team.settle()

    def teardown(self):
        if hasattr(self, "team"):
            self.team.settle()


EVERY = list(HealthCheck)
TestFaults = Faults.TestCase
TestFaults.settings = settings(
    max_examples=50, stateful_step_count=50, deadline=None, derandomize=True, suppress_health_check=EVERY
)


@pytest.mark.slow
class TestManyFaults(Faults.TestCase):
    settings = settings(
        max_examples=400, stateful_step_count=50, deadline=None, derandomize=True, suppress_health_check=EVERY
    )

"""Hostile messages, clock changes and freezes with real processes; `test_hostile` covers the protocol alone."""

import math
import signal
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from option_coordinator.protocol.protocol_types import AgentState, GrantStatus
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rig import COORDINATOR, write_policy
from rosgraph_msgs.msg import Clock

from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, OptionRequest

pytestmark = [pytest.mark.fault, pytest.mark.timeout(900)]  # waits end by themselves, see `PATIENCE`
LONG_LEASE = 4.0
"""Lease for tests on a busy machine, where a shorter one could expire without a clock change [s]."""
PLAIN = str(Path(__file__).with_name("plain_robot.py"))


def goes_on(rig, *robots, grants=5):
    """Check that all processes run and these robots are granted options; `until` checks the processes."""
    for robot in robots or ("r0", "r1"):
        rig.granted(robot, len(rig.given(robot)) + grants)


def test_impossible_numbers_in_a_heartbeat_end_neither_decider_nor_standby(rig):
    rig.coordinator("first", "second", longest_option=60.0)
    rig.robot("r0", lasts=0.0)
    rig.robot("r1", lasts=0.1)
    rig.granted("r0")
    running = rig.until(lambda: rig.running("r0"), "it works")
    for elapsed in (math.nan, math.inf, -math.inf, -1e308, 1e308, 1e6, 1e4):
        rig.status_publisher.publish(
            AgentStatus(
                agent="r0",
                incarnation=running.incarnation,
                state=int(AgentState.RUNNING),
                coordinator_epoch=running.coordinator_epoch,
                request_id=running.request_id,
                grant_id=running.grant_id + 1,
                option=1,
                elapsed=elapsed,
            )
        )
        rig.ask(
            "r0", running.request_id + 1, running.incarnation, running.coordinator_epoch, option_reward=1.0
        )  # and it has brought something
        goes_on(rig, "r1", grants=2)
    rig.until(lambda: rig.counted("not taken: elapsed out of range", "first") >= 4, "the decider counts them")
    rig.until(lambda: rig.counted("not taken: elapsed out of range", "second") >= 4, "and the standby")
    assert all(abs(step.reward) < 100.0 for step in rig.steps)


def test_two_teams_in_one_namespace_do_not_disturb_each_other(rig, tmp_path):
    other = tmp_path / "other.safetensors"
    write_policy(other, robots=2, names=("s0", "s1"))
    rig.coordinator("ours", team_name="ours")
    rig.coordinator("theirs", team_name="theirs", policy=other)
    for name in ("r0", "r1"):
        rig.robot(name, team="ours", lasts=0.1)
    for name in ("s0", "s1"):
        rig.robot(name, team="theirs", lasts=0.1)
    goes_on(rig, "r0", "r1", "s0", "s1")
    assert {grant.team for grant in rig.grants if grant.agent.startswith("r")} == {"ours"}
    assert {grant.team for grant in rig.grants if grant.agent.startswith("s")} == {"theirs"}
    assert not [grant for grant in rig.grants if grant.status is GrantStatus.REFUSED]
    assert rig.counted("stepped down", "ours") == rig.counted("stepped down", "theirs") == 0


def test_teams_of_the_same_robots_names_are_told_apart_by_their_own(rig):
    for team in ("ours", "theirs"):
        rig.coordinator(team, team_name=team)
        rig.robot("r0", node=f"{team}_r0", team=team, lasts=0.1)
        rig.robot("r1", node=f"{team}_r1", team=team, lasts=0.1)

    def both():
        found = Counter((g.team, g.agent) for g in rig.grants if g.status is GrantStatus.GRANTED)
        return all(found[team, robot] >= 5 for team in ("ours", "theirs") for robot in ("r0", "r1"))

    rig.until(both, "both teams are granted options")


def test_epochs_and_numbers_out_of_reach_stop_no_granting_and_make_no_second_decider(rig):
    rig.coordinator("first", "second")
    words = rig.node.create_publisher(CoordinatorStatus, "coordinator_status", 1000)
    rig.robot("r0", lasts=0.1)
    rig.robot("r1", lasts=0.1)
    goes_on(rig)
    rig.until(lambda: any(status.agent == "r0" for status in rig.statuses), "r0 is heard")
    life = next(status.incarnation for status in reversed(rig.statuses) if status.agent == "r0")
    for epoch in (2**62 - 1, 2**64 - 1, 2**62, 2**61 - 1):
        rig.say(AgentState.WAITING, agent="nobody", coordinator_epoch=epoch)
        rig.say(AgentState.WAITING, agent="r0", incarnation=life, coordinator_epoch=epoch)
        words.publish(CoordinatorStatus(coordinator_epoch=epoch))
        words.publish(CoordinatorStatus(coordinator_epoch=epoch, team="another"))
    for request_id in (2**64 - 1, 2**62 - 1, 10**6, 900):
        rig.ask("r0", request_id=request_id, incarnation=life)
    goes_on(rig, grants=20)
    before = len(rig.grants)
    goes_on(rig, grants=10)
    assert len({grant.coordinator_epoch for grant in rig.grants[before:]}) == 1
    assert max(grant.coordinator_epoch for grant in rig.grants) < 100 << 32
    assert rig.until(lambda: rig.deciding("first", "second"), "one decides")


def test_rising_epochs_of_an_unknown_name_stop_no_granting(rig):
    rig.coordinator()
    rig.robot("r0", lasts=0.1)
    rig.robot("r1", lasts=0.1)
    goes_on(rig)
    epoch = rig.grants[-1].coordinator_epoch
    for rise in range(1, 50):
        rig.say(AgentState.WAITING, agent="nobody", coordinator_epoch=epoch + (rise << 32))
        rig.let_pass(0.02)
    goes_on(rig)
    assert {grant.coordinator_epoch for grant in rig.grants} == {epoch}


def test_a_thawed_coordinator_grants_nothing_in_its_dead_epoch(rig):
    names = ["first", "second"]
    rig.coordinator(*names)
    rig.robot("r0", lasts=0.05)
    rig.robot("r1", lasts=0.05)
    for _ in range(2):
        goes_on(rig)
        frozen = rig.until(lambda: rig.deciding(*names), "one decides")
        dead = max(grant.coordinator_epoch for grant in rig.grants)
        rig.signal(frozen, signal.SIGSTOP)
        try:
            rig.until(lambda dead=dead: rig.grants[-1].coordinator_epoch > dead, "the other one takes over")
            goes_on(rig)
        finally:
            heard, thawed = len(rig.grants), time.time()
            rig.signal(frozen, signal.SIGCONT)
        goes_on(rig, grants=20)
        # What it had decided before may be on its way still.
        late = [grant for grant in rig.grants[heard:] if grant.coordinator_epoch <= dead and grant.stamp > thawed]
        assert not late, "it decided in an epoch that was over"


def test_giant_and_broken_requests_are_dropped_and_starve_nobody(rig):
    rig.coordinator()
    rig.robot("r1", lasts=0.05)
    goes_on(rig, "r1")
    giant = serialize_message(OptionRequest(agent="r0", incarnation=1, request_id=1, legal=[True] * 10**6))
    whole = serialize_message(OptionRequest(agent="r0", incarnation=1, request_id=1, observation=[0.0, 0.0]))
    memory = resident(rig.processes["coordinator"].pid)
    for content in [giant] * 20 + [whole[:4], whole[:40], whole[:-5], b"\x00\x01\x00\x00" + bytes(range(200))]:
        rig.request_publisher.publish(content)
        rig.let_pass(0.02)
    rig.until(lambda: rig.counted("not taken: request too long") == 20, "the giants are counted")
    rig.until(lambda: rig.counted("not taken: request of another layout") >= 2, "and what is no request")
    goes_on(rig, "r1")
    assert not any(len(grant.reason) > 500 for grant in rig.grants)
    assert resident(rig.processes["coordinator"].pid) - memory < 40e6


def resident(pid):
    """Resident memory of a process [bytes]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


def test_a_refusal_says_how_many_and_not_which(rig):
    rig.coordinator()
    answer = rig.answer(lambda g: g.status is GrantStatus.REFUSED, "a refusal", legal=np.ones(9000, bool))
    assert "9000 legal options" in answer.reason
    assert len(answer.reason) < 120


class Simulation:
    """Publisher of /clock, whose time can be set and stopped."""

    def __init__(self, rig):
        self.rig, self.time = rig, 1e6
        self.publisher = rig.node.create_publisher(Clock, "/clock", QoSProfile(depth=1))

    def run(self, seconds, steps=True):
        for _ in range(round(seconds / 0.05)):
            self.time += 0.05 * steps
            message = Clock()
            message.clock.sec, message.clock.nanosec = int(self.time), round(1e9 * (self.time % 1.0)) % 10**9
            self.publisher.publish(message)
            self.rig.let_pass(0.05)

    def goes_on(self, robots=("r0", "r1"), grants=4):
        wanted = {robot: len(self.rig.given(robot)) + grants for robot in robots}
        self.rig.until(lambda: self.run(0.1) or all(len(self.rig.given(r)) >= n for r, n in wanted.items()), "grants")


def test_a_clock_that_jumps_or_stops_ends_nothing_and_granting_goes_on(rig):
    simulation = Simulation(rig)
    for name in ("first", "second"):
        rig.start(name, COORDINATOR, **settings(rig))
    rig.robot("r0", lasts=0.2, use_sim_time="true")
    rig.robot("r1", lasts=0.2, use_sim_time="true")
    simulation.goes_on()
    for jump in (72_000.0, -3600.0, -72_000.0, 3600.0):
        simulation.time += jump
        simulation.goes_on()
    simulation.run(1.25 * LONG_LEASE, steps=False)  # paused: nobody is lost, nobody takes over
    last = rig.until(lambda: rig.deciding("first", "second"), "one decides")
    assert rig.counted("lost robots", last) == 0
    assert all(math.isfinite(step.reward) and abs(step.reward) < 100.0 for step in rig.steps)
    epochs = {grant.coordinator_epoch for grant in rig.grants}
    assert len(epochs) == 1  # the clock of stamps ends nobody's lease
    rig.kill(last)
    simulation.time -= 600.0  # and the other one takes over while the clock is behind
    simulation.goes_on()
    assert rig.grants[-1].coordinator_epoch > max(epochs)


def settings(rig):
    return {
        "policy": rig.policy,
        "lease": LONG_LEASE,
        "lost_after": LONG_LEASE,
        "policy_limit": 10.0,
        "stale": 30.0,
        "longest_option": 60.0,
        "use_sim_time": "true",
    }


def test_a_robot_written_from_the_message_files_alone_works_with_all_that_happens(rig):
    rig.coordinator("first", "second", team_name="ours", longest_option=60.0)
    rig.start("plain", PLAIN, "r0", "ours")
    rig.robot("r1", team="ours", lasts=0.1)
    goes_on(rig)
    rig.kill(rig.until(lambda: rig.deciding("first", "second"), "one decides"))
    goes_on(rig)
    assert not [
        g for g in rig.grants if g.agent == "r0" and g.status is GrantStatus.REFUSED and "epoch" not in g.reason
    ]
    rewards = [step.reward for step in rig.steps]
    assert sum(rewards) > 0.0

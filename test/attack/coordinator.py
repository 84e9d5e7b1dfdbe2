"""Coordinators and robots under a hail of hostile messages, with freezes, kills and clocks that are set."""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from _attack import Attack

TESTS = Path(__file__).resolve().parents[2] / "option_coordinator" / "test"
ROBOTS = ("r0", "r1")
COORDINATORS = ("first", "second")
HAIL_S = 8.0
COUNTS = (0, 1, 2, 900, 10**6, 2**32, 2**61 - 1, 2**61, 2**62 - 1, 2**62, 2**63, 2**64 - 1)
REALS = (0.0, -1.0, 1e-300, 1e4, 1e6, 1e9, -1e308, 1e308, math.nan, math.inf, -math.inf)


def run(random: np.random.Generator, folder: Path) -> None:
    """Let a team work, attack it for some seconds, and see that it goes on."""
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"  # LOCALHOST would bring shared memory back
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(Path(__file__).parents[1] / "loopback_udp.xml")
    sys.path.insert(0, str(TESTS))
    import rclpy
    from rig import Rig

    rclpy.init()
    rig = Rig(folder)
    try:
        clock = SetClock(rig.node) if random.random() < 0.5 else None
        attack(rig, random, clock)
    finally:
        rig.close()
        rig.node.destroy_node()
        rclpy.try_shutdown()


def attack(rig: Any, random: np.random.Generator, clock: SetClock | None) -> None:
    """Do one round; `Rig.until` raises where a process has ended by itself."""
    settings = {"longest_option": 20.0, "use_sim_time": str(clock is not None).lower()}
    rig.coordinator(*COORDINATORS, **settings)
    for robot in ROBOTS:
        rig.robot(robot, lasts=0.1, use_sim_time=settings["use_sim_time"])
    serves(rig)
    lives = {status.agent: status.incarnation for status in rig.statuses}
    aimed = bool(random.random() < 0.5)
    hail, faults = Hail(rig, random, lives if aimed else {}), Faults(rig, random, settings)
    end = time.monotonic() + HAIL_S
    while time.monotonic() < end:
        for _ in range(random.integers(1, 8)):
            hail.strike()
        faults.strike()
        if clock is not None and random.random() < 0.02:
            clock.jump(float(random.choice((-72_000.0, -60.0, -1.0, 60.0, 72_000.0))))
        rig.let_pass(0.02)
    faults.end()
    serves(rig)
    assert all(math.isfinite(step.reward) and abs(step.reward) < 1e12 for step in rig.steps)
    assert all(np.isfinite(step.observations).all() for step in rig.steps)
    assert all(len(grant.reason) <= 500 for grant in rig.grants)
    if not aimed:
        one_grant_for_each_request(rig, set(lives.items()))


def serves(rig: Any) -> None:
    """Wait until each robot has been granted some options more."""
    for robot in ROBOTS:
        rig.granted(robot, len(rig.given(robot)) + 5)


def one_grant_for_each_request(rig: Any, lives: set[tuple[str, int]]) -> None:
    """In one epoch a request has one grant, unless somebody speaks in the robot's very life."""
    answers: dict[tuple[int, ...], set[tuple[int, int]]] = {}
    for grant in rig.grants:
        if grant.status == 0 and (grant.agent, grant.incarnation) in lives:
            key = (grant.coordinator_epoch, grant.incarnation, grant.request_id)
            answers.setdefault(key, set()).add((grant.grant_id, grant.option))
    assert answers
    assert all(len(found) == 1 for found in answers.values()), "one request has two grants"


class SetClock:
    """A simulated clock that somebody sets."""

    def __init__(self, node: Any) -> None:
        from rosgraph_msgs.msg import Clock

        self._message, self._offset = Clock(), 1e6
        self._publisher = node.create_publisher(Clock, "/clock", 1)
        self._begin = time.monotonic()
        node.create_timer(0.02, self._publish)

    def jump(self, seconds: float) -> None:
        """Set it ahead or back."""
        self._offset = max(1e5, self._offset + seconds)

    def _publish(self) -> None:
        now = self._offset + time.monotonic() - self._begin
        self._message.clock.sec, self._message.clock.nanosec = int(now), int(1e9 * (now % 1.0))
        self._publisher.publish(self._message)


class Faults:
    """Freezes and kills processes at random."""

    def __init__(self, rig: Any, random: np.random.Generator, settings: dict[str, Any]) -> None:
        self._rig, self._random, self._settings = rig, random, settings
        self._frozen: tuple[str, float] | None = None
        self._kills = 1

    def strike(self) -> None:
        """Freeze somebody now and then, thaw it later; kill one coordinator and start it again."""
        if self._frozen is not None:
            if time.monotonic() > self._frozen[1]:
                self.end()
        elif self._random.random() < 0.05:
            name = str(self._random.choice([*COORDINATORS, *ROBOTS]))
            self._rig.signal(name, signal.SIGSTOP)
            self._frozen = name, time.monotonic() + self._random.uniform(0.1, 2.0)
        elif self._kills and self._random.random() < 0.02:
            self._kills -= 1
            name = str(self._random.choice(COORDINATORS))
            self._rig.kill(name)
            self._rig.coordinator(name, **self._settings)

    def end(self) -> None:
        """Let whoever is frozen go on."""
        if self._frozen is not None:
            self._rig.signal(self._frozen[0], signal.SIGCONT)
            self._frozen = None


class Hail:
    """Messages that a hostile or broken peer might send: any field may have any value.

    Args:
        rig: the processes, and publishers of their topics.
        random: Generator that the messages are drawn from.
        lives: Incarnations of the robots in whose very lives some are sent, by name.
    """

    def __init__(self, rig: Any, random: np.random.Generator, lives: dict[str, int]) -> None:
        from ctrl_rl_msgs.msg import CoordinatorStatus

        self._rig, self._random, self._lives = rig, random, lives
        self._words = rig.node.create_publisher(CoordinatorStatus, "coordinator_status", 1000)

    def strike(self) -> None:
        """Send one message."""
        (self._request, self._status, self._grant, self._word)[self._random.integers(4)]()

    def _who(self) -> dict[str, Any]:
        """Who it is said to be, with numbers of all sizes."""
        agent = str(self._random.choice([*ROBOTS, "nobody", "", "x" * 10_000, "r0\x01"]))
        life = self._lives.get(agent) if self._random.random() < 0.5 else None
        return {
            "agent": agent,
            "incarnation": life or self._count(),
            "request_id": self._count(),
            "coordinator_epoch": self._epoch(),
            "team": str(self._random.choice(["", "", "other", "y" * 1000])),
        }

    def _request(self) -> None:
        from ctrl_rl_msgs.msg import OptionRequest

        random = self._random
        options = int(random.choice((0, 1, 3, 3, 4, 20_000)))
        message = OptionRequest(
            **self._who(),
            observation=random.choice(
                (0.0, 1e30, math.nan, math.inf), int(random.choice((0, 2, 2, 3, 100_000)))
            ).tolist(),
            legal=(random.random(options) < 0.5).tolist(),
            option_reward=float(random.choice(REALS)),
            option_duration=int(random.choice((0, 1, 2**32 - 1))),
            terminated=bool(random.random() < 0.1),
        )
        message.header.stamp.sec = int(random.choice((0, -(2**31), 2**31 - 1, int(time.time()))))
        self._rig.request_publisher.publish(message)

    def _status(self) -> None:
        from ctrl_rl_msgs.msg import AgentStatus

        random = self._random
        told = {"grant_id": self._count(), "option": int(random.choice((0, 1, 2, 3, 2**32 - 1)))}
        state, elapsed = int(random.choice((0, 1, 2, 2, 3, 4, 255))), float(random.choice(REALS))
        self._rig.status_publisher.publish(AgentStatus(**self._who(), **told, state=state, elapsed=elapsed))

    def _grant(self) -> None:
        from ctrl_rl_msgs.msg import OptionGrant

        random = self._random
        told = {"grant_id": self._count(), "option": int(random.choice((0, 1, 2, 3, 2**32 - 1)))}
        status, deadline = int(random.choice((0, 1, 2, 3, 255))), float(random.choice(REALS))
        message = OptionGrant(**self._who(), **told, status=status, deadline=deadline)
        self._rig.grant_publisher.publish(message)

    def _word(self) -> None:
        from ctrl_rl_msgs.msg import CoordinatorStatus

        epoch = self._epoch() if self._random.random() < 0.2 else self._count()
        team = str(self._random.choice(["", "other", "z" * 1000]))
        self._words.publish(CoordinatorStatus(coordinator_epoch=epoch, team=team))

    def _count(self) -> int:
        return int(self._random.choice(np.array(COUNTS, np.uint64)))

    def _epoch(self) -> int:
        """An epoch of any size, or one that is just above what is heard."""
        heard = self._rig.steps[-1].coordinator_epoch if self._rig.steps else 0
        return self._count() if self._random.random() < 0.7 else heard + (int(self._random.integers(1, 40)) << 32)


ATTACKS = (
    Attack(
        "coordinator",
        "No message, freeze, kill or set clock ends a coordinator, grants a request twice or stops granting for good.",
        run,
        limit_s=400.0,
    ),
)

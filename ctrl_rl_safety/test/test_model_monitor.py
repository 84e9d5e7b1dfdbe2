"""Bounds of a model grow to what was seen at once, and not at all where the model is right."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from ctrl_rl_safety.models.motion import motion_of, next_state
from ctrl_rl_safety.monitor import Bounds, ModelMonitor
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ctrl_rl_safety import ROBOTS, RobotModel

STEP = 0.01
NAMES = ("turtlebot3_burger", "turtlebot2", "turtlebot4", "jackal")
Commands = Callable[[float], tuple[float, float]]


class Drive:
    """A robot that need not be as its monitor's model says.

    Attributes:
        state: x, y, theta, v, omega.
        grown_at: Time at which bounds first grew [s].
    """

    def __init__(
        self, stated: RobotModel, truth: RobotModel, seed: int = 0, noise: float = 1.0, every: int = 2
    ) -> None:
        self.monitor, self.truth = ModelMonitor(stated), truth
        self.state, self.time, self.grown_at = np.zeros(5), 0.0, math.nan
        self.slip, self.pushed, self.gain, self.held = 1.0, 0.0, 1.0, False
        self._random, self._noise, self._every = np.random.default_rng(seed), noise, every
        self._under_way: deque[tuple[float, tuple[float, float]]] = deque()
        self._command, self._step = (0.0, 0.0), 0

    def go(self, commands: Commands, seconds: float) -> ModelMonitor:
        for _ in range(round(seconds / STEP)):
            if self._step % 5 == 0:
                command = commands(self.time)
                self.monitor.sent(self.time, np.array(command))
                self._under_way.append((self.time + self.truth.delay - 1e-9, command))
            while self._under_way and self._under_way[0][0] <= self.time:
                self._command = self._under_way.popleft()[1]
            told = (0.0, 0.0) if self.held else (self.gain * self._command[0], self._command[1])
            after = np.array(next_state(*self.state, *told, motion_of(self.truth, STEP)))
            after[:2] = self.state[:2] + self.slip * (after[:2] - self.state[:2])
            self.state, self._step = after, self._step + 1
            self.time = self._step * STEP
            if self._step % self._every == 0:
                noise = self._noise * self._random.uniform(-1.0, 1.0, 5) * (0.002, 0.002, 0.001, 0.01, 0.02)
                seen = self.state + noise + (0.0, 0.0, 0.0, self.pushed, 0.0)
                self.monitor.measure(self.time, seen[:3], float(seen[3]), float(seen[4]))
            if math.isnan(self.grown_at) and self.monitor.grown != Bounds():
                self.grown_at = self.time
        return self.monitor


def at_random(model: RobotModel, seed: int) -> Commands:
    """Return commands that change now and then, at once or slowly."""
    random, held = (
        np.random.default_rng(seed),
        {"until": 0.0, "from": np.zeros(2), "to": np.zeros(2), "at": 0.0, "ramp": 0.0},
    )

    def command(time: float) -> tuple[float, float]:
        if time >= held["until"]:
            low, high = model.limits
            wanted = random.uniform(low, high) * random.integers(0, 2, 2)
            now = held["to"]
            held.update({"from": now, "to": wanted, "at": time, "ramp": random.choice((0.0, 0.0, 0.5))})
            held["until"] = time + random.uniform(0.1, 2.5)
        share = 1.0 if held["ramp"] == 0.0 else min((time - held["at"]) / held["ramp"], 1.0)
        v, omega = held["from"] + share * (held["to"] - held["from"])
        return float(v), float(omega)

    return command


@pytest.mark.parametrize("robot", NAMES)
@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(
    seed=st.integers(0, 10_000),
    earlier=st.floats(0.0, 1.0),
    stronger=st.floats(1.0, 2.0),
    slower=st.floats(0.3, 1.0),
    every=st.sampled_from((2, 3, 5, 10)),
)
def test_nothing_grows_where_the_robot_is_within_its_bounds(
    robot: str, seed: int, earlier: float, stronger: float, slower: float, every: int
) -> None:
    stated = ROBOTS[robot]
    truth = replace(
        stated,
        delay=round(earlier * stated.delay, 2),
        braking=stronger * stated.braking,
        acceleration=slower * stated.acceleration,
        turn_acceleration=stronger * stated.turn_acceleration,
    )
    monitor = Drive(stated, truth, seed, every=every).go(at_random(stated, seed), 20.0)
    assert monitor.grown == Bounds()
    assert not monitor.problem


@pytest.mark.parametrize("robot", NAMES)
@pytest.mark.parametrize("later", [0.15, 0.3, 0.6])
def test_a_late_start_shows_the_delay_before_the_robot_has_gone_far(robot: str, later: float) -> None:
    stated = ROBOTS[robot]
    drive = Drive(stated, replace(stated, delay=stated.delay + later))
    monitor = drive.go(lambda _: (stated.speed, 0.0), stated.delay + later + 0.3)
    assert later - 0.06 <= monitor.grown.delay <= later + 0.3
    assert drive.grown_at < stated.delay + later + 0.1
    assert monitor.grown.braking == 1.0
    assert monitor.model.delay >= stated.delay + later - 0.06


@pytest.mark.parametrize("robot", ["turtlebot2", "jackal"])
@pytest.mark.parametrize("share", [0.8, 0.5])
def test_weak_brakes_show_at_the_first_stop(robot: str, share: float) -> None:
    stated = ROBOTS[robot]
    drive = Drive(stated, replace(stated, braking=share * stated.braking))
    monitor = drive.go(lambda time: (stated.speed if time < 2.0 else 0.0, 0.0), 2.0)
    assert monitor.grown == Bounds()
    monitor = drive.go(lambda _: (0.0, 0.0), 2.0)
    assert share - 0.11 <= monitor.grown.braking <= share + 0.08
    assert drive.grown_at < 2.0 + stated.delay + 0.5 * stated.speed / stated.braking + 0.1
    assert not monitor.problem


def test_brakes_that_fail_after_they_were_shown_are_noticed_too() -> None:
    stated = ROBOTS["jackal"]
    drive = Drive(stated, stated)
    stop_and_go = lambda time: (stated.speed if time % 4.0 < 2.0 else 0.0, 0.0)  # noqa: E731
    assert drive.go(stop_and_go, 8.0).grown == Bounds()
    drive.truth = replace(stated, braking=0.6 * stated.braking)
    assert drive.go(stop_and_go, 4.0).grown.braking <= 0.7


@pytest.mark.parametrize("robot", NAMES)
def test_a_robot_that_turns_weakly_is_noticed(robot: str) -> None:
    stated = ROBOTS[robot]
    drive = Drive(stated, replace(stated, turn_acceleration=0.5 * stated.turn_acceleration))
    monitor = drive.go(lambda time: (0.0, stated.turn_rate * (1.0 if time % 3.0 < 1.5 else -1.0)), 6.0)
    assert 0.25 <= monitor.grown.turning <= 0.6
    assert not monitor.problem


def test_what_a_robot_has_shown_is_relied_on() -> None:
    stated = ROBOTS["jackal"]
    drive = Drive(stated, stated)
    assert drive.monitor.model.braking == pytest.approx(0.8 * stated.braking)
    assert drive.monitor.model.delay == pytest.approx(stated.delay + 0.15)
    assert drive.go(lambda _: (stated.speed, 0.0), 1.0).model.delay == stated.delay
    assert drive.go(lambda _: (0.0, 0.0), 2.0).model == stated


def test_a_robot_that_does_not_stop_stands() -> None:
    stated = ROBOTS["jackal"]
    drive = Drive(stated, replace(stated, braking=0.05 * stated.braking))
    monitor = drive.go(lambda time: (1.0 if time < 2.0 else 0.0, 0.0), 4.0)
    assert "than any bound allows" in monitor.problem
    drive.truth = stated
    assert drive.go(lambda _: (0.0, 0.0), 5.0).problem


def test_a_robot_that_is_pushed_stands_until_it_is_left_alone() -> None:
    stated = ROBOTS["turtlebot4"]
    drive = Drive(stated, stated)
    assert not drive.go(lambda _: (0.0, 0.0), 3.0).problem
    drive.pushed = 0.2
    assert "pushed" in drive.go(lambda _: (0.0, 0.0), 2.0).problem
    drive.pushed = 0.0
    monitor = drive.go(lambda _: (0.0, 0.0), 2.0)
    assert not monitor.problem
    assert monitor.grown.braking == 1.0
    assert monitor.grown.delay == 0.0


@pytest.mark.parametrize("robot", NAMES)
def test_a_robot_that_is_held_has_no_delay(robot: str) -> None:
    stated = ROBOTS[robot]
    drive = Drive(stated, stated)
    drive.go(lambda _: (stated.speed, 0.0), 2.0)
    drive.held = True
    drive.go(lambda _: (stated.speed, 0.0), 3.0)
    drive.held = False
    monitor = drive.go(lambda time: (stated.speed * (time < 8.0), 0.0), 5.0)
    assert monitor.grown == Bounds()
    assert not monitor.problem


def test_a_robot_that_exceeds_its_commands_or_slips_disturbs_and_stands_beyond_a_limit() -> None:
    stated = ROBOTS["jackal"]
    fast, sliding, lost = (Drive(stated, stated) for _ in range(3))
    fast.gain, sliding.slip, lost.slip = 1.12, 0.7, 0.0
    monitor = fast.go(lambda _: (1.0, 0.0), 3.0)
    assert 0.05 < monitor.grown.disturbance < 0.4
    assert not monitor.problem
    monitor = sliding.go(lambda _: (1.0, 0.0), 3.0)
    assert 0.1 < monitor.grown.disturbance < 0.4
    assert not monitor.problem
    assert "moves elsewhere" in lost.go(lambda _: (2.0, 0.0), 3.0).problem


def test_a_quick_robot_is_taken_for_what_it_is() -> None:
    stated = ROBOTS["turtlebot3_burger"]
    quick = replace(stated, acceleration=50.0, braking=50.0, turn_acceleration=100.0, lag=0.0, delay=0.0)
    monitor = Drive(stated, quick).go(at_random(stated, 1), 20.0)
    assert monitor.grown.braking == monitor.grown.turning == 1.0
    assert monitor.grown.delay == 0.0
    assert not monitor.problem


def test_two_wheels_that_share_their_force_are_no_weak_brakes() -> None:
    stated = replace(ROBOTS["turtlebot2"], track=0.23, turn_acceleration=8.0)
    monitor = Drive(stated, stated).go(at_random(stated, 3), 30.0)
    assert monitor.grown == Bounds()
    assert not monitor.problem


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(seed=st.integers(0, 10_000), robot=st.sampled_from(NAMES), delay=st.floats(0.0, 2.0))
def test_whatever_is_measured_the_model_stays_one_of_a_robot(seed: int, robot: str, delay: float) -> None:
    random, stated = np.random.default_rng(seed), replace(ROBOTS[robot], delay=delay)
    monitor, time = ModelMonitor(stated), 0.0
    for _ in range(200):
        time += random.choice((0.0, 0.02, 0.02, 0.05, 1.0, -0.5))
        size = 10.0 ** random.uniform(-3.0, 4.0)
        if random.random() < 0.7:
            monitor.sent(time, random.uniform(*stated.limits))
        monitor.measure(time, size * random.standard_normal(3), *(size * random.standard_normal(2)))
        if random.random() < 0.02:
            monitor.forget()
        assert monitor.model.braking >= 0.3 * stated.braking - 1e-9
        assert monitor.model.delay >= stated.delay
    assert monitor.problem

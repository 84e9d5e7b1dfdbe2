"""A drive that gets no nearer, repeats a stretch, or takes ever longer detours is noticed."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from ctrl_rl_navigation.driving.decision import Goal, NavigatorOptions, NavigatorState
from ctrl_rl_navigation.driving.navigator import Navigator
from ctrl_rl_navigation.driving.progress import Progress
from ctrl_rl_navigation.robot import limits_of

from ctrl_rl_core import OccupancyMap, find_robot

SPEED, PERIOD = 0.2, 0.1


class Walk:
    """A robot that walks along a line, and notes its progress."""

    def __init__(self) -> None:
        self.progress, self.now, self.x = Progress(), 0.0, 0.0
        self.most = 1

    def to(self, x: float, left: Callable[[float], float]) -> None:
        """Walk to a place, with the time to reach that a value has at each place."""
        while abs(x - self.x) > 1e-6:
            self.x += math.copysign(min(SPEED * PERIOD, abs(x - self.x)), x - self.x)
            self.now += PERIOD
            self.progress.note(self.now, np.array((self.x, 0.0)), left(self.x))
            self.most = max(self.most, self.progress.passes)


def test_a_drive_straight_to_the_goal_repeats_nothing() -> None:
    walk = Walk()
    walk.to(20.0, lambda x: (20.0 - x) / SPEED)
    assert (walk.most, walk.progress.tries, walk.progress.detour) == (1, 0, 0.0)


def test_shuttling_between_two_doors_is_counted_in_one_direction() -> None:
    walk = Walk()
    for _ in range(3):
        walk.progress.solved()
        walk.to(5.0, lambda x: (5.0 - x) / SPEED)
        walk.progress.solved()
        walk.to(0.0, lambda x: x / SPEED)
    assert walk.most == 3
    # At each end the other door becomes the near one: the whole way of 25 s is added.
    assert walk.progress.detour == pytest.approx(5 * 25.0, abs=1.0)


def test_driving_back_once_and_past_the_place_with_less_left_is_no_repetition() -> None:
    walk = Walk()
    walk.to(3.0, lambda x: 60.0 - x / SPEED)
    walk.progress.solved()
    walk.to(0.0, lambda x: 45.0 + x / SPEED)
    walk.progress.solved()
    walk.to(3.0, lambda x: 30.0 - x / SPEED)
    assert walk.most == 1


def test_patience_ends_without_progress_and_is_not_prolonged_by_values_for_ever() -> None:
    progress, ends = Progress(), 0
    for tick in range(200):
        if tick % 20 == 0:
            progress.solved()
        ends += progress.note(PERIOD * tick, np.zeros(2), 30.0)
    assert ends == 3
    assert progress.tries == 3
    assert not progress.note(PERIOD * 200 + 60.0, np.zeros(2), 30.0), "it stood for another reason"


HALL = np.zeros((60, 120), np.int8)
HALL[:2], HALL[-2:], HALL[:, :2], HALL[:, -2:] = (100,) * 4
POSE = np.array((1.0, 1.5, 0.0))


@pytest.fixture
def navigator() -> Navigator:
    options = NavigatorOptions(inline=True, max_detour=20.0)
    navigator = Navigator(limits_of(find_robot("turtlebot3_burger")), options)
    navigator.set_map(OccupancyMap(HALL, 0.05))
    navigator.set_goal(Goal((5.0, 1.5)))
    assert navigator.decide(0.0, POSE, np.empty((0, 2))).state is NavigatorState.DRIVING
    return navigator


def wall(low: float, high: float, x: float = 2.0) -> np.ndarray:
    """Return the echoes of a wall across the hall, from the robot's pose."""
    y = np.arange(low, high, 0.02)
    return np.column_stack((np.full(len(y), x), y)) - POSE[:2]


def run(navigator: Navigator, begin: float, seconds: float, echoes: np.ndarray) -> str:
    """Let the navigator see a wall from where it is, and return its words."""
    for now in np.arange(begin, begin + seconds, 0.2):
        navigator.see(now, POSE, echoes)
        decision = navigator.decide(now, POSE, echoes)
    return f"{decision.state.name} {decision.message}"


def test_a_detour_is_told_and_one_that_is_too_long_stops_it(navigator: Navigator) -> None:
    assert run(navigator, 0.2, 3.0, wall(0.9, 2.4)).startswith("DRIVING driving a detour of ")
    assert 0.5 < navigator.detour < 20.0
    navigator.options = replace(navigator.options, max_detour=0.5)
    assert "round obstacles is more than `max_detour`" in run(navigator, 3.2, 1.0, wall(0.9, 2.4))
    behind = wall(0.0, 3.0, 5.9)
    assert run(navigator, 4.2, 6.0, behind).startswith("DRIVING driving")
    assert navigator.detour == pytest.approx(0.0, abs=0.3)


def test_where_every_way_is_closed_it_looks_again_once_where_it_cannot_see(navigator: Navigator) -> None:
    assert run(navigator, 0.2, 4.0, wall(0.0, 3.0)).startswith("BLOCKED an unmapped obstacle blocks every path")
    solves = navigator.solves
    told = run(navigator, 5.0, 6.0, np.empty((0, 2)))
    assert navigator.solves == solves + 1
    assert told.startswith("DRIVING driving to look again at obstacles seen before")
    assert run(navigator, 12.0, 4.0, wall(0.0, 3.0)).startswith("BLOCKED")
    solves = navigator.solves
    assert run(navigator, 20.0, 30.0, np.empty((0, 2))).startswith("BLOCKED")
    assert navigator.solves == solves
    navigator.set_goal(Goal((5.0, 1.5)))
    assert run(navigator, 70.0, 0.3, np.empty((0, 2))) == "DRIVING driving"


def test_driving_the_same_way_for_the_third_time_stops_it(navigator: Navigator) -> None:
    now, x, message = 0.0, 1.0, ""
    while now < 120.0 and "the same way" not in message:
        x += 0.02 * (1.0 if (now // 10.0) % 2 == 0 else -1.0)
        now += 0.1
        decision = navigator.decide(now, np.array((x, 1.5, 0.0)), np.empty((0, 2)))
        message = decision.message
    assert (decision.state, decision.command.tolist()) == (NavigatorState.BLOCKED, [0.0, 0.0])
    assert message == "the same way was driven 3 times without getting nearer to the goal"
    assert 40.0 < now < 60.0

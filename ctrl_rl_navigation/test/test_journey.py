"""Paths as legs, and journeys: progress, patience, and what ends them."""

import numpy as np
import pytest
from ctrl_rl_navigation.driving import Goal, Journey, NavigatorState, legs_along
from ctrl_rl_navigation.driving.decision import Decision
from ctrl_rl_navigation.driving.journey import Failure
from ctrl_rl_navigation.driving.path_legs import legs_to
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.robot import limits_of

from ctrl_rl_core import OccupancyMap, find_robot
from ctrl_rl_navigation import MapSolver

HERE = np.array((0.0, 0.0, 0.0))
STAND = np.zeros(2)


class Double:
    """A navigator whose value is there at once, and which is where the test says."""

    def __init__(self) -> None:
        self.goal: Goal | None = None
        self.is_asked = False
        self.remaining_distance = 3.0
        self.asked: list[Goal] = []
        self.cancelled = 0

    def set_goal(self, goal: Goal) -> None:
        self.goal = goal
        self.asked.append(goal)

    def cancel(self) -> bool:
        self.cancelled += 1
        return True


def drive(state: NavigatorState, left: float = 5.0) -> Decision:
    return Decision(STAND, state, state.name.lower(), left)


def journey(navigator: Double, stops: bool = False) -> Journey:
    return Journey(navigator, legs_to([Goal((2.0, 0.0)), Goal((2.0, 3.0))]), 0.2, 10.0, stops)


def test_it_passes_a_goal_only_if_the_way_to_it_is_short() -> None:
    navigator = Double()
    trip = journey(navigator)
    trip.update(0.0, drive(NavigatorState.DRIVING), HERE)
    assert trip.remaining(drive(NavigatorState.DRIVING), HERE) == (6.0, 5.0 + 3.0 / 0.2)
    trip.update(0.1, drive(NavigatorState.DRIVING, 20.0), np.array((1.8, 0.0, 0.0)))  # behind a wall
    assert trip.left == 2
    trip.update(0.2, drive(NavigatorState.DRIVING, 1.0), np.array((1.8, 0.0, 0.0)))
    assert trip.left == 1
    trip.update(0.3, drive(NavigatorState.DRIVING, 1.0), np.array((2.0, 2.9, 0.0)))
    assert not trip.arrived  # the last one must be reached
    trip.update(0.4, drive(NavigatorState.REACHED), np.array((2.0, 2.9, 0.0)))
    assert trip.arrived
    assert [goal.position for goal in navigator.asked] == [(2.0, 0.0), (2.0, 3.0)]


def test_it_is_patient_with_obstacles_and_counts_them() -> None:
    navigator = Double()
    trip = journey(navigator, stops=True)
    for second in range(9):
        trip.update(float(second), drive(NavigatorState.BLOCKED), HERE)
    trip.update(9.0, drive(NavigatorState.DRIVING), HERE)
    assert (trip.failure, trip.recoveries) == (None, 1)
    trip.update(1e6, drive(NavigatorState.WAITING), HERE)  # a clock that leaps counts as a second
    assert trip.failure is None
    for second in range(10):
        trip.update(1e6 + second + 1.0, drive(NavigatorState.WAITING), HERE)
    assert trip.failure is Failure.NO_INPUT
    assert trip.reason == "waiting (for 10 s)"
    assert navigator.cancelled == 1


def test_it_ends_where_there_is_no_way_or_another_goal() -> None:
    navigator = Double()
    trip = journey(navigator)
    navigator.is_asked = True  # the state is still that of the goal before
    trip.update(0.0, drive(NavigatorState.REACHED), HERE)
    assert trip.left == 2
    navigator.is_asked = False
    trip.update(0.1, drive(NavigatorState.UNREACHABLE), HERE)
    assert trip.failure is Failure.NO_WAY
    other = Double()
    trip = journey(other)
    other.goal = Goal((9.0, 9.0))
    trip.update(0.0, drive(NavigatorState.DRIVING), HERE)
    assert trip.failure is Failure.REPLACED
    assert other.cancelled == 0


def test_a_path_is_cut_where_it_comes_back_beside_itself() -> None:
    straight = np.array(((0.0, 0.0), (8.0, 0.0)))
    (leg,) = legs_along(straight, 1.0, 0.5, None)
    assert (leg.goal.position, leg.goal.heading) == ((8.0, 0.0), 1.0)
    assert leg.length == pytest.approx(8.0, abs=0.01)
    hairpin = np.array(((0.0, 0.0), (6.0, 0.0), (6.0, 1.0), (0.0, 1.0)))
    legs = legs_along(hairpin, 1.0, 0.5, np.array((0.5, 0.2, 0.0)))
    assert len(legs) > 1
    assert [leg.goal.heading for leg in legs] == [None] * (len(legs) - 1) + [1.0]
    assert sum(leg.length for leg in legs) == pytest.approx(12.5, abs=0.3)
    for leg in legs:
        points = np.array(leg.goal.path)
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        far = np.abs(np.subtract.outer(np.arange(len(points)), np.arange(len(points)))) > 55
        assert not (apart[far] < 1.6).any()
    assert legs[0].goal.path is not None
    assert legs[0].goal.path[0] == (0.5, 0.2)


@pytest.mark.parametrize("path", [np.empty((0, 2)), np.array(((0.0, np.nan),)), np.array(((0.0, 0.0), (2e3, 0.0)))])
def test_paths_that_are_none_are_refused(path: np.ndarray) -> None:
    with pytest.raises(NavigationError, match="the path"):
        legs_along(path, None, 0.5, None)


def test_the_value_of_a_path_leads_back_to_it_and_along_it() -> None:
    limits = limits_of(find_robot("turtlebot3_burger"))
    solver = MapSolver(OccupancyMap(np.zeros((120, 120), np.int8), 0.05), limits)
    corner = np.array(((1.0, 1.0), (5.0, 1.0), (5.0, 5.0)))
    value = solver.solve((5.0, 5.0), 0.1, along=(corner, 0.5))
    assert float(value.value((1.0, 1.0))) == pytest.approx(8.0 / limits.speed, rel=0.1)
    assert float(value.value((3.0, 1.3))) > float(value.value((3.0, 1.0)))
    assert np.isinf(value.value((2.5, 3.5)))  # the short way is not the path
    way = value.path((2.0, 1.4))
    late = way[np.hypot(*(way - way[0]).T) > 1.0]
    beside = np.minimum(np.abs(late[:, 1] - 1.0), np.abs(late[:, 0] - 5.0))
    assert beside.max() < 0.1

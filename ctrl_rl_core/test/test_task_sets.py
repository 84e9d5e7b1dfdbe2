"""Classification of states into the sets of a task."""

import numpy as np
import pytest
from ctrl_rl_core.tasks.task_sets import PathCoordinates
from hypothesis import given
from hypothesis import strategies as st

from ctrl_rl_core import Outcome, TaskSets, load_navigation_task

RUNNING, GOAL, COLLISION, TRAP = Outcome.RUNNING, Outcome.GOAL, Outcome.COLLISION, Outcome.TRAP


def test_goal_obstacles_walls_and_the_rest_of_a_car():
    sets = TaskSets(load_navigation_task("car_ttr"))
    states = np.array(
        [(4.0, 4.0, 0.75), (4.0, 4.0, 2.0), (0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (4.7, 0.0, 0.0), (0, -3, 1)]
    )
    outcomes = [GOAL, RUNNING, COLLISION, COLLISION, COLLISION, RUNNING]
    assert sets.outcomes(states).tolist() == outcomes
    assert sets.outcomes(states[0]).tolist() == GOAL
    assert sets.clearance((0.55, 0.0, 0.0)) == pytest.approx(0.55 - 0.35 - 0.177)


def test_trap_and_tilt_of_a_quadrotor():
    task = load_navigation_task("quad_trap")
    sets = TaskSets(task)
    region = task.trap.region
    trapped = [region.intervals[name].centre if name in region.intervals else 0.0 for name in ("x", "z", "psi")]
    state = np.array((trapped[0], 0.0, trapped[1], 0.0, trapped[2], 0.0))
    assert sets.outcomes(state) in (TRAP, COLLISION)  # its trap touches the floor
    state[2] = region.intervals["z"].high
    assert sets.outcomes(state) == TRAP
    state[2], state[4] = 5.0, task.robot.tilt_limit + 0.1
    assert sets.outcomes(state) == COLLISION


def test_a_corridor_ends_where_its_path_says():
    task = load_navigation_task("curved_corridor")
    sets, path = TaskSets(task), task.corridor.path
    states = path.pose([0.4, 5.0, 6.7])
    assert sets.outcomes(states).tolist() == [RUNNING, RUNNING, GOAL]
    aside = states + 0.24 * np.column_stack((-np.sin(states[:, 2]), np.cos(states[:, 2]), np.zeros(3)))
    assert sets.outcomes(aside).tolist() == [COLLISION] * 3
    assert TaskSets(task, width=0.8).outcomes(aside).tolist() == [RUNNING, RUNNING, GOAL]


@given(st.floats(0.05, 6.85), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0))
def test_path_coordinates_undo_the_path(s, lateral, heading):
    path = load_navigation_task("curved_corridor").corridor.path
    x, y, direction = path.pose(s)
    pose = (x - lateral * np.sin(direction), y + lateral * np.cos(direction), direction + heading)
    found = PathCoordinates(path)(pose)
    np.testing.assert_allclose(found[:2], (s, lateral), atol=0.01)
    np.testing.assert_allclose(np.sin(found[2] - heading), 0.0, atol=0.02)

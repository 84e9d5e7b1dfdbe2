"""The problem in a corridor: path coordinates, trajectories clear of the real walls, and their values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oc_baseline_node.problems.coordinates import curvature, in_plane, path_car
from oc_baseline_node.values.value_file import load_network

from ctrl_rl_core import Outcome, TaskSets, load_navigation_task, make_system
from oc_baseline_node import Mpc, OcError, draw_start, find_value, formulate

TASK = load_navigation_task("curved_corridor")
PATH = TASK.corridor.path
CAR = make_system("dubins_car", control_bounds={"v": (0.0, 0.22), "omega": (-1.5, 1.5)})


def test_the_curvature_turns_as_far_as_the_path_does():
    s = np.linspace(-1.0, PATH.length + 1.0, 20_001)
    turned = np.trapezoid(curvature(PATH, s), s)
    assert turned == pytest.approx(float(PATH.pose(PATH.length)[2] - PATH.pose(0.0)[2]), abs=1e-6)
    assert curvature(PATH, np.array([0.5, 1.8])) == pytest.approx([0.0, 1.0], abs=1e-6)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    s=st.floats(0.3, 5.0),
    lateral=st.floats(-0.2, 0.2),
    heading=st.floats(-1.0, 1.0),
    v=st.floats(0.05, 0.22),
    omega=st.floats(-1.0, 1.0),
)
def test_along_the_path_and_in_the_plane_the_car_drives_the_same_way(s, lateral, heading, v, omega):
    along, u = np.array([s, lateral, heading]), np.array([v, omega])
    plane, car = in_plane(PATH, along), path_car(CAR, PATH)
    for _ in range(20):
        along, plane = car.step(along, u, dt=0.05), CAR.step(plane, u, dt=0.05)
    # Only the rounded steps of the curvature tell them apart.
    np.testing.assert_allclose(in_plane(PATH, along)[:2], plane[:2], atol=0.01)
    assert np.abs(np.angle(np.exp(1j * (in_plane(PATH, along)[2] - plane[2])))) < 0.06


def test_trajectories_keep_clear_of_the_real_walls_and_arrive():
    problem, sets = formulate(TASK), TaskSets(TASK)
    random, mpc = np.random.default_rng(4), Mpc(formulate(TASK))
    for _ in range(3):
        trajectory = mpc.solve(draw_start(problem, random))
        assert trajectory.solved, trajectory.reason
        states = problem.task_states(trajectory.states)
        world = TASK.build_world()
        # A wall on the outside of a turn is made of straight boxes, which cut 2 mm into the free width.
        assert world.signed_distance(states[:, :2]).min() > problem.clearance - 0.004
        outcomes = sets.outcomes(states)
        assert outcomes[-1] == Outcome.GOAL
        assert not (outcomes == Outcome.COLLISION).any()


def test_the_value_that_comes_with_the_package_rises_along_the_corridor():
    value = load_network(find_value("curved_corridor"))
    poses = PATH.pose(np.linspace(0.4, 6.4, 13))
    values = value.value(poses)
    assert (np.diff(values) > 0.0).all()
    assert values[-1] > 900.0
    assert value.value([[0.5, 0.34, 0.0]]) == TASK.rewards.collision  # in the wall


def test_refusals():
    box = load_navigation_task("car_navigation").obstacles[:1]
    with pytest.raises(OcError, match="in a corridor does not support obstacles"):
        formulate(TASK.model_copy(update={"obstacles": box}))
    with pytest.raises(OcError, match="must be 'dubins_car', not 'bicycle'"):
        path_car(make_system("bicycle"), PATH)
    with pytest.raises(OcError, match=r"no state is 0\.4 m from the walls"):
        formulate(TASK, clearance=0.4)

"""The robot of a simulated world in the drive loop."""

import numpy as np
import pytest

from ctrl_rl_core import FunctionDriver, PolicyDriver, drive, find_policy, load_navigation_task, load_policy
from sim_bridge import RobotSenses, SimulatedRobot, SimulatedWorld, SimulationOptions, goal_of

TASK = load_navigation_task("car_ttr")
SETTINGS = SimulationOptions(engine="planar", rate=30)


def test_a_policy_drives_it_and_the_same_seed_is_the_same_episode() -> None:
    world = SimulatedWorld(TASK, options=SETTINGS)
    robot = SimulatedRobot(world, TASK.episode.time_step, goal_of(TASK))
    driver = PolicyDriver(load_policy(find_policy("car_ttr")))
    first, again = drive(robot, driver, seeds=(3, 3), keep=True)
    world.close()
    assert (first.outcome, first.steps) == ("GOAL", again.steps)
    assert np.array_equal(first.states, again.states)
    sensors = first.trace[2].sensors
    assert sensors.time == pytest.approx(2 * TASK.episode.time_step)
    goal = goal_of(TASK)
    assert goal is not None
    assert (sensors.age, sensors.goal.tolist()) == (0.0, goal.tolist())
    assert np.array_equal(sensors.command, first.trace[2].command), "what was sent is sensed"
    assert sensors.speeds[0] > 0.05


def test_who_stands_too_long_is_cut() -> None:
    world = SimulatedWorld(TASK, options=SETTINGS)
    (episode,) = drive(SimulatedRobot(world, 0.4, patience=2.0), FunctionDriver(lambda _: np.zeros(2)), seeds=(0,))
    world.close()
    assert (episode.outcome, episode.steps) == ("RUNNING", 5)
    assert episode.info["stood"] == pytest.approx(2.0)


def test_a_scan_is_shown_with_its_age_until_the_next() -> None:
    world = SimulatedWorld(TASK, options=SETTINGS)
    senses = RobotSenses(world)
    assert len(senses(np.zeros(2), look=False).ranges) == 0, "no scan yet"
    scan = senses(np.zeros(2))
    world.step(6)
    later = senses(np.zeros(2), look=False)
    assert later.ranges is scan.ranges
    assert (scan.age, later.age) == (0.0, pytest.approx(0.2))
    world.close()


def test_a_goal_along_a_corridor_has_no_place() -> None:
    assert goal_of(load_navigation_task("curved_corridor")) is None

"""A fleet moves, senses and terminates like single robots in the planar engine."""

import numpy as np
import pytest

from ctrl_rl_core import Outcome, load_navigation_task
from sim_bridge import NavigationEnv, PlanarFleet, SimulationError, SimulationOptions


@pytest.mark.parametrize(("task", "drift"), [("car_navigation", 0.6), ("quad_trap", 0.0), ("car_ttr", -0.6)])
def test_a_fleet_does_what_single_robots_do(task, drift):
    fleet = PlanarFleet(load_navigation_task(task), size=4)
    single = NavigationEnv(task, options=SimulationOptions(engine="planar", rate=30 if task[0] == "c" else 60))
    random = np.random.default_rng(1)
    actions = np.clip(drift + random.normal(0.0, 0.5, (60, 4, 2)), -1.0, 1.0)
    seen, ends = [fleet.observations()], []
    rewards, states, outcomes = [], [], []
    for action in actions:
        outcomes.append(fleet.step(action).copy())
        seen.append(fleet.observations())
        rewards.append(fleet.rewards())
        states.append(fleet.states())
    for robot in range(4):
        observation, _ = single.reset(seed=robot)
        np.testing.assert_allclose(seen[0][robot], observation, atol=1e-5)
        for step, action in enumerate(actions):
            observation, reward, terminated, truncated, info = single.step(action[robot])
            assert info["outcome"] == Outcome(outcomes[step][robot]).name
            assert reward == rewards[step][robot]
            np.testing.assert_allclose(states[step][robot], info["state"], atol=1e-9)
            np.testing.assert_allclose(seen[step + 1][robot], observation, atol=1e-5)
            if terminated or truncated:
                ends.append(info["outcome"])
                break
    single.close()
    assert ends, "no episode ended: the comparison saw no outcome"


def test_a_robot_begins_anew_while_the_others_go_on():
    fleet = PlanarFleet(load_navigation_task("car_ttr"), size=2)
    fleet.step(np.ones((2, 2)))
    before = fleet.states()[1]
    fleet.begin(0, 7, (1.0, -2.0, 0.5))
    np.testing.assert_allclose(fleet.states(), [(1.0, -2.0, 0.5), before])


@pytest.mark.parametrize("actions", [np.ones(2), np.full((2, 2), np.nan), np.ones((3, 2))])
def test_actions_that_are_none_are_refused(actions):
    fleet = PlanarFleet(load_navigation_task("car_ttr"), size=2)
    with pytest.raises(SimulationError, match="two finite numbers for each of 2 robots"):
        fleet.step(actions)


def test_a_task_whose_episodes_differ_is_refused():
    with pytest.raises(SimulationError, match="a fleet does not support 'corridor'"):
        PlanarFleet(load_navigation_task("curved_corridor"), size=2)

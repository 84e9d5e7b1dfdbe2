"""Tasks by Gymnasium's own calls: one robot passes its checker, a fleet steps and begins anew as Gymnasium says."""

import gymnasium
import numpy as np
import pytest
from ctrl_rl.environments import ALONE, FLEET  # registers the tasks
from gymnasium.utils.env_checker import check_env

import ctrl_rl
from ctrl_rl_core import task_names


def test_all_tasks_in_arenas_and_on_maps_are_registered() -> None:
    known = set()
    for name in task_names():
        task = ctrl_rl.load_task(name)
        if getattr(task, "kind", "") == "navigation" and task.corridor is None:
            known.add(name)
    assert known == {*FLEET, *ALONE}


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("task", ["car_ttr", "quad_ttr"])
def test_a_task_passes_gymnasiums_checker(task: str) -> None:
    environment = gymnasium.make(f"ctrl_rl/{task}-v0", engine="planar")
    check_env(environment.unwrapped, skip_render_check=True)
    environment.close()


def test_a_fleet_begins_anew_in_the_same_step() -> None:
    environments = gymnasium.make_vec("ctrl_rl/car_ttr-v0", num_envs=3)
    observed, _ = environments.reset(seed=4)
    again, _ = environments.reset(seed=4)
    np.testing.assert_array_equal(observed[:, :3], again[:, :3])
    assert observed in environments.observation_space
    ended = 0
    for _ in range(400):
        observed, rewards, terminated, truncated, info = environments.step(np.tile((1.0, 0.0), (3, 1)))
        assert rewards.shape == terminated.shape == truncated.shape == (3,)
        assert not np.any(terminated & truncated)
        for robot in np.flatnonzero(terminated | truncated):
            ended += 1
            assert info["final_obs"][robot].shape == observed[robot].shape
            assert not np.allclose(info["final_obs"][robot], observed[robot])
            assert info["final_info"]["outcome"][robot] in ("GOAL", "COLLISION", "TIMEOUT")
    assert ended >= 3


def test_one_robot_and_a_fleet_see_the_same() -> None:
    one = gymnasium.make("ctrl_rl/car_ttr-v0", engine="planar")
    fleet = gymnasium.make_vec("ctrl_rl/car_ttr-v0", num_envs=1)
    assert one.observation_space.shape == fleet.single_observation_space.shape
    assert one.action_space == fleet.single_action_space


def test_a_reward_wraps_the_fleet() -> None:
    value = ctrl_rl.solve("car_ttr", counts=(31, 31, 16))
    environments = ctrl_rl.TimeToReachVectorReward(gymnasium.make_vec("ctrl_rl/car_ttr-v0", num_envs=2), value)
    environments.reset(seed=0)
    assert environments.step(np.zeros((2, 2), np.float32))[1].shape == (2,)

"""A fleet by Gymnasium's own call: it begins anew as Gymnasium says, and sees what one robot sees."""

import gymnasium
import numpy as np
import pytest

from sim_bridge import NavigationEnv, SimulationOptions, register_environments

register_environments()


def test_it_begins_anew_in_the_same_step() -> None:
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
        assert observed in environments.observation_space
        for robot in np.flatnonzero(terminated | truncated):
            ended += 1
            assert info["final_obs"][robot].shape == observed[robot].shape
            assert not np.allclose(info["final_obs"][robot], observed[robot])
            assert info["final_info"]["outcome"][robot] in ("GOAL", "COLLISION", "TIMEOUT")
    assert ended >= 3


def test_one_robot_and_a_fleet_see_the_same() -> None:
    one = NavigationEnv("car_ttr", options=SimulationOptions(engine="planar", rate=30))
    fleet = gymnasium.make_vec("ctrl_rl/car_ttr-v0", num_envs=2)
    assert one.observation_space == fleet.single_observation_space
    assert one.action_space == fleet.single_action_space
    _, info = fleet.reset(seed=1)
    seen, _ = one.reset(seed=0, options={"start": info["state"][1]})
    for _ in range(5):
        many, *_, info = fleet.step(np.tile((0.5, 0.3), (2, 1)).astype(np.float32))
        seen, *_ = one.step(np.array((0.5, 0.3), np.float32))
    np.testing.assert_allclose(many[1], seen, atol=1e-4)


def test_a_world_that_changes_has_no_fleet() -> None:
    with pytest.raises(Exception, match="vector"):
        gymnasium.make_vec("ctrl_rl/curved_corridor-v0", num_envs=2, vectorization_mode="vector_entry_point")

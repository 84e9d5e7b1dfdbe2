import re

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st
from sim_bridge.simulation.options import whole_steps

from ctrl_rl_core import load_navigation_task
from sim_bridge import NavigationEnv, SimulationError, SimulationOptions, register_environments

IDS = register_environments()


@pytest.mark.parametrize("identifier", IDS)
def test_gymnasium_accepts_it(identifier):
    environment = gymnasium.make(identifier).unwrapped
    check_env(environment, skip_render_check=True)
    environment.close()


def test_every_navigation_task_is_registered():
    assert {"ctrl_rl/car_ttr-v0", "ctrl_rl/curved_corridor-v0", "ctrl_rl/quad_trap-v0"} <= set(IDS)


def test_observations_are_named_and_in_si_units():
    environment = NavigationEnv("curved_corridor", options=SimulationOptions(scan_noise=0.0))
    observation, info = environment.reset(seed=3)
    assert environment.observation_names[:6] == ("x", "y", "theta", "v", "omega", "beam_0")
    assert len(environment.observation_names) == 5 + 360 == observation.size
    np.testing.assert_allclose(observation[:3], info["state"], atol=1e-6)
    assert observation[5:].min() >= 0.12
    assert observation[5:].max() <= np.float32(3.5)
    for _ in range(5):
        observation, *_ = environment.step(np.array((0.5, 0.0), dtype=np.float32))
    assert observation[3] == pytest.approx(0.11, rel=0.05)
    environment.close()


def test_actions_span_the_command_bounds():
    environment = NavigationEnv("car_ttr")
    environment.reset(seed=0)
    for _ in range(3):
        environment.step(np.array((1.0, -1.0), dtype=np.float32))
    forward, _, turn = environment.world.velocity(0)
    assert forward == pytest.approx(2.0, rel=0.03)
    assert turn == pytest.approx(-0.5, rel=0.03)
    environment.close()


@pytest.mark.parametrize(
    ("name", "action", "outcome"),
    [
        ("car_ttr", (1.0, 1.0), "COLLISION"),
        ("quad_ttr", (1.0, -1.0), "COLLISION"),
        ("car_ttr", (-0.4286, 0.0), "TIMEOUT"),
    ],
)
def test_rewards_are_those_of_the_task(name, action, outcome):
    environment = NavigationEnv(name)
    environment.reset(seed=1)
    rewards, steps, ended = [], 0, False
    while not ended:
        _, reward, terminated, truncated, info = environment.step(np.array(action, dtype=np.float32))
        rewards.append(reward)
        steps, ended = steps + 1, terminated or truncated
    assert info["outcome"] == outcome
    assert truncated == (outcome == "TIMEOUT")
    assert rewards[-1] == -400.0
    assert not any(rewards[:-1])
    assert steps <= environment.task.episode.steps
    environment.close()


def test_the_same_seed_and_actions_give_the_same_bits():
    runs = []
    for _ in range(2):
        environment = NavigationEnv("curved_corridor")
        observations = [environment.reset(seed=9)[0]]
        observations += [environment.step(np.array((0.8, -0.1), dtype=np.float32))[0] for _ in range(10)]
        runs.append(np.stack(observations))
        environment.close()
    np.testing.assert_array_equal(runs[0], runs[1])


def test_vectorised_environments_are_as_single_ones():
    vector = gymnasium.make_vec("ctrl_rl/car_navigation-v0", num_envs=3, vectorization_mode="sync")
    single = gymnasium.make("ctrl_rl/car_navigation-v0")
    many, _ = vector.reset(seed=[4, 5, 6])
    one, _ = single.reset(seed=5)
    np.testing.assert_array_equal(many[1], one)
    action = np.array((0.6, 0.2), dtype=np.float32)
    for _ in range(5):
        many, *_ = vector.step(np.tile(action, (3, 1)))
        one, *_ = single.step(action)
    np.testing.assert_array_equal(many[1], one)
    vector.close()
    single.close()


def test_a_time_step_of_broken_physics_steps_is_refused():
    with pytest.raises(SimulationError, match=r"or choose another rate$"):
        NavigationEnv("quad_ttr", options=SimulationOptions(rate=110))


@given(step=st.floats(1e-3, 2.0), rate=st.sampled_from((60, 110, 240, 250, 1000)))
def test_the_time_step_that_is_advised_is_taken(step, rate):
    task = load_navigation_task("car_ttr")

    def lasting(seconds):
        return task.model_copy(update={"episode": task.episode.model_copy(update={"time_step": seconds})})

    try:
        whole_steps(lasting(step), rate)
    except SimulationError as error:
        advised = float(re.search(r"give it (\S+) s", str(error)).group(1))
        assert whole_steps(lasting(advised), rate) >= 1


def test_an_action_that_is_not_finite_is_refused():
    environment = NavigationEnv("car_ttr")
    environment.reset(seed=0)
    with pytest.raises(SimulationError, match="finite"):
        environment.step(np.array((np.nan, 0.0), dtype=np.float32))
    environment.close()

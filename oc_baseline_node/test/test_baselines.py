"""Any function of the observation as a baseline: the formulas of Eq. 3.14 on Stable-Baselines3's own rollouts."""

import gymnasium
import numpy as np
import pytest
import torch
from ctrl_rl_learning.sb3 import REWARD_SCALE, make_environment
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from oc_baseline_node.training.baselines.control_variates import make_critic, value_and_slope
from oc_baseline_node.training.baselines.policy_gradient import (
    BaselineBuffer,
    BaselinePolicy,
    CorrectedPolicy,
    OcBaseline,
)
from oc_baseline_node.values.value_file import load_network
from sb3_contrib import TRPO
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy

from ctrl_rl_core import load_navigation_task
from oc_baseline_node import OcError, find_value

OBSERVED, COMMANDS = spaces.Box(-10.0, 10.0, (3,)), spaces.Box(-1.0, 1.0, (2,))


class Drift(gymnasium.Env):
    """Point moved by actions and rewarded near 0; episodes end at 20 steps by time limit, or earlier by termination."""

    observation_space, action_space = OBSERVED, COMMANDS

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed, options=options)
        self._x, self._left = self.np_random.uniform(-1.0, 1.0, 3).astype(np.float32), 20
        return self._x.copy(), {}

    def step(self, action):
        self._x[:2] += 0.1 * np.asarray(action, dtype=np.float32)
        self._left -= 1
        over = self._left == 0
        return self._x.copy(), -float(np.abs(self._x).sum()), over and self._x[2] > 0.0, over and self._x[2] <= 0.0, {}


def some_baseline(observations):
    return (2.0 * observations[:, 0] - observations[:, 1] ** 2).astype(np.float32)


def filled_buffer(steps, environments, gae_lambda, gamma, baseline, seed):
    """Buffer of random samples whose last observation has the value `last`."""
    random = np.random.default_rng(seed)
    buffer = BaselineBuffer(steps, OBSERVED, COMMANDS, "cpu", gae_lambda, gamma, environments, baseline=baseline)
    starts = random.random((steps, environments)) < 0.3
    for step in range(steps):
        buffer.add(
            random.normal(size=(environments, 3)).astype(np.float32),
            random.normal(size=(environments, 2)).astype(np.float32),
            random.normal(size=environments),
            starts[step],
            torch.from_numpy(random.normal(size=environments)),
            torch.zeros(environments),
        )
    last, dones = random.normal(size=environments), random.random(environments) < 0.5
    buffer.compute_returns_and_advantage(torch.from_numpy(last), dones)
    return buffer, np.vstack((starts[1:], dones)), np.vstack((buffer.values[1:], last))


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 8), st.integers(1, 3), st.floats(0.5, 1.0), st.floats(0.0, 1.0), st.integers(0, 1000))
def test_advantages_are_returns_less_the_baseline(steps, environments, gamma, gae_lambda, seed):
    buffer, ended, following = filled_buffer(steps, environments, gae_lambda, gamma, some_baseline, seed)
    returns = np.zeros((steps + 1, environments))
    for step in reversed(range(steps)):
        # G_k = r + gamma ((1 - lambda) V(s') + lambda G_k+1), which ends with the episode, and on V with the roll-out.
        ahead = (
            following[step]
            if step == steps - 1
            else (1 - gae_lambda) * following[step] + gae_lambda * returns[step + 1]
        )
        returns[step] = buffer.rewards[step] + gamma * ~ended[step] * ahead
    assert buffer.returns == pytest.approx(returns[:-1], abs=1e-4)
    b = some_baseline(buffer.observations.reshape(-1, 3)).reshape(steps, environments)
    assert buffer.advantages == pytest.approx(buffer.returns - b, abs=1e-5)
    ((low, middle, high),) = buffer.take_ranges()
    assert low <= middle <= high
    assert buffer.take_ranges() == []


def test_without_a_baseline_everything_is_as_in_the_library():
    buffer, _, _ = filled_buffer(6, 2, 0.9, 0.95, None, 0)
    assert buffer.advantages == pytest.approx(buffer.returns - buffer.values, abs=1e-5)


@pytest.mark.parametrize("kind", [PPO, TRPO])
def test_a_constant_added_to_the_baseline_changes_nothing(kind):
    """Standardised advantages do not depend on it."""

    def learnt(constant):
        made = {"rollout_buffer_class": BaselineBuffer, "n_steps": 64, "batch_size": 64, "seed": 3, "device": "cpu"}
        made["rollout_buffer_kwargs"] = {"baseline": lambda observations: some_baseline(observations) + constant}
        model = kind("MlpPolicy", Drift(), **made)
        model.learn(128)
        return torch.cat([part.detach().flatten() for part in model.policy.mlp_extractor.policy_net.parameters()])

    one, other = learnt(np.float32(0.0)), learnt(np.float32(4.0))
    assert one.numpy() == pytest.approx(other.numpy(), abs=2e-3)


def test_a_policy_with_a_baseline_ends_its_returns_on_it_and_never_learns_it():
    model = PPO(
        BaselinePolicy, Drift(), n_steps=64, batch_size=64, n_epochs=2, seed=0, device="cpu", vf_coef=0.0,
        rollout_buffer_class=BaselineBuffer, policy_kwargs={"baseline": some_baseline},
    )  # fmt: skip
    before = [part.detach().clone() for part in model.policy.value_net.parameters()]
    model.learn(64)
    buffer = model.rollout_buffer
    assert buffer.values.ravel() == pytest.approx(some_baseline(buffer.observations.reshape(-1, 3)), abs=1e-5)
    assert all(torch.equal(a, b) for a, b in zip(before, model.policy.value_net.parameters(), strict=True))


def test_a_corrected_value_begins_as_the_baseline_and_learns_what_the_policy_earns():
    constant = 3.0  # far from the truth

    def wrong(observations):
        return some_baseline(observations) + np.float32(constant)

    model = PPO(
        CorrectedPolicy, Drift(), n_steps=256, batch_size=64, n_epochs=10, learning_rate=3e-3, seed=0, device="cpu",
        rollout_buffer_class=BaselineBuffer, policy_kwargs={"baseline": wrong},
    )  # fmt: skip
    buffer = model.rollout_buffer

    def observed():
        return buffer.observations.reshape(-1, 3)

    model.learn(256)
    assert buffer.values.ravel() == pytest.approx(wrong(observed()), abs=1e-5)
    first = np.abs(buffer.returns - buffer.values).mean()
    model.learn(256 * 30)
    assert np.abs(buffer.returns - buffer.values).mean() < 0.5 * first
    shown = torch.from_numpy(observed())
    with torch.no_grad():
        values, *_ = model.policy.evaluate_actions(shown, torch.zeros(len(shown), 1))
        _, acted, _ = model.policy(shown)
        assert torch.equal(values, model.policy.predict_values(shown))
        assert torch.equal(values, acted)


def gaussian_policy():
    torch.manual_seed(0)
    policy = ActorCriticPolicy(OBSERVED, COMMANDS, lambda _: 1e-3, net_arch=[8])
    parameters = [*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters(), policy.log_std]
    observations = torch.randn(40_000, 3, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        actions = policy.get_distribution(observations).get_actions()
    return policy, parameters, observations, actions


def mean_gradient(values, parameters):
    found = torch.autograd.grad(values.mean(), parameters, allow_unused=True, materialize_grads=True)
    return torch.cat([part.flatten() for part in found])


def test_a_baseline_leaves_the_gradient_unbiased():
    policy, parameters, observations, actions = gaussian_policy()
    b = torch.from_numpy(some_baseline(observations.numpy()))
    log_probability = policy.get_distribution(observations).log_prob(actions)
    by_baseline = mean_gradient(log_probability * b, parameters)
    by_reward = mean_gradient(policy.get_distribution(observations).log_prob(actions) * actions[:, 0], parameters)
    assert by_baseline.norm() < 0.05 * by_reward.norm() * b.std()


@pytest.mark.parametrize("through_noise", [True, False])
def test_what_a_control_variate_takes_is_given_back_through_the_policy(through_noise):
    """E[grad log pi c] = E[grad_a c grad f] (Stein's identity); for c linear in a, the mean alone suffices."""
    policy, parameters, observations, actions = gaussian_policy()
    critic = make_critic(5)
    distribution = policy.get_distribution(observations).distribution
    mean = distribution.mean.detach()
    if through_noise:
        c, slope = value_and_slope(critic, observations, actions)
        noise = (actions - mean) / distribution.stddev.detach()
        reached = distribution.mean + distribution.stddev * noise
    else:
        _, slope = value_and_slope(critic, observations, mean)
        c, reached = (slope * (actions - mean)).sum(dim=1), distribution.mean
    given_back = mean_gradient((slope * reached).sum(dim=1), parameters)
    log_probability = policy.get_distribution(observations).log_prob(actions)
    # Any function of the observation may be taken off c: its mean there makes the estimate of the left side sharp.
    level, _ = value_and_slope(critic, observations, mean)
    taken = mean_gradient(log_probability * (c - level if through_noise else c), parameters)
    assert float(taken @ given_back / (taken.norm() * given_back.norm())) > 0.98
    assert float(taken.norm() / given_back.norm()) == pytest.approx(1.0, abs=0.1)


def test_the_oc_baseline_is_the_value_of_the_state_in_an_observation():
    task = load_navigation_task("quad_trap")
    value = load_network(find_value("quad_trap"))
    environment = make_environment(task)
    observation, info = environment.reset(seed=1)
    environment.close()
    b = OcBaseline(value, task)
    assert b(observation[None])[0] == pytest.approx(REWARD_SCALE * value.value(info["state"]), rel=1e-3)
    far = observation + 100.0
    assert np.isfinite(b(far[None])).all()
    noisy = OcBaseline(value, task, 0.1)
    torch.manual_seed(0)
    first = noisy(observation[None])
    assert first != b(observation[None])
    torch.manual_seed(0)
    assert noisy(observation[None]) == first
    with pytest.raises(OcError, match="has other states than task 'car_navigation'"):
        OcBaseline(value, load_navigation_task("car_navigation"))

"""Updates of the agent with values on model features: the parameters moved by each loss, and the targets."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.agents import cuda_graph
from koopman_lqr_controller.training.agents.actor import AgentInterface
from koopman_lqr_controller.training.agents.model_based_agent import ModelBasedAgent
from koopman_lqr_controller.training.environments.benchmark_tasks import BENCHMARK_TASKS
from koopman_lqr_controller.training.replay import Mirror, SequenceReplay
from koopman_lqr_controller.training.settings import RECIPES, Settings
from torch import Tensor, nn

SHAPE, CONTROLS, LENGTH = 3, 2, RECIPES["model_based"]["model_steps"]
INTERFACE = AgentInterface((SHAPE,), CONTROLS, np.zeros((), np.float32), np.ones((), np.float32), None)
GOAL = np.array([0.5, -1.0, 2.0], np.float32)


def some_agent(goal: np.ndarray | None = None, device: str = "cpu", **changes: object) -> ModelBasedAgent:
    small = {"hidden": 16, "latent": 6, "batch": 32, **RECIPES["model_based"]}
    return ModelBasedAgent(INTERFACE._replace(goal=goal), Settings(**{**small, **changes}), 0, device)


def lived(agent: ModelBasedAgent, steps: int = 60, seed: int = 0) -> SequenceReplay:
    """Return a replay with a random episode whose observations the agent has processed."""
    random = np.random.default_rng(seed)
    replay = agent.make_replay(INTERFACE, 1000)
    for _ in range(steps):
        x = random.normal(size=SHAPE).astype(np.float32)
        agent.meet(x)
        replay.add(x, random.uniform(-1.0, 1.0, CONTROLS).astype(np.float32), float(random.normal()), False)
    replay.end_episode(random.normal(size=SHAPE).astype(np.float32))
    return replay


def weights(module: nn.Module) -> list[Tensor]:
    return [p.detach().clone() for p in module.parameters()]


@pytest.mark.parametrize("goal", [None, GOAL])
def test_each_loss_moves_what_it_should_and_nothing_else(goal: np.ndarray | None) -> None:
    agent = some_agent(goal)
    batch = agent._draw(lived(agent), np.random.default_rng(0), None)[1]
    encoder = agent.actor.encoder
    parts = {
        "features": encoder.body,
        "z": encoder.head,
        "representation": agent.representation,
        "critic": agent.critic,
        "lqr": agent.lqr,
        "targets": nn.ModuleList((agent.target_actor, agent.target_representation, agent.target_critic)),
    }
    with torch.no_grad():
        features = encoder.features(batch.x[:, 0])

    def moved(learn: Callable[[], object]) -> set[str]:
        before = {name: weights(part) for name, part in parts.items()}
        learn()
        return {
            name
            for name, part in parts.items()
            if any(not torch.equal(a, b) for a, b in zip(before[name], part.parameters(), strict=True))
        }

    assert moved(lambda: agent._learn_representation(*batch)) == {"features", "representation"}
    assert moved(lambda: agent._learn_values(batch, features, torch.zeros(CONTROLS))) == {"critic"}
    assert moved(lambda: agent._learn_law(batch, features)) == {"z", "lqr"}


def test_targets_stay_as_they_are_until_they_are_renewed() -> None:
    agent = some_agent(renewal=3)
    replay, random, generator = lived(agent), np.random.default_rng(0), torch.Generator().manual_seed(0)
    pairs = (
        (agent.target_actor, agent.actor),
        (agent.target_representation, agent.representation),
        (agent.target_critic, agent.critic),
    )
    seen = []
    for _ in range(7):
        agent.learn(replay, random, generator, None)
        seen.append(weights(agent.target_critic))
    changed = [not torch.equal(a[0], b[0]) for a, b in pairwise(seen)]
    assert changed == [False, False, True, False, False, True]
    agent._renew_targets(replay)
    assert all(torch.equal(a, b) for pair in pairs for a, b in zip(*map(weights, pair), strict=True))
    assert agent.updates == 7
    assert float(agent.reward_scale[0]) == pytest.approx(np.abs(replay.everything().reward).mean())


def test_goals_are_rewards_of_some_steps_and_the_value_of_what_follows() -> None:
    agent = some_agent(discount=0.9)
    batch = agent._draw(lived(agent), np.random.default_rng(0), None)[1]
    goes_on = batch.goes_on.clone()
    goes_on[0, 1] = 0.0  # the second step is an episode's last one
    batch = batch._replace(goes_on=goes_on)
    agent.reward_scale.copy_(torch.tensor([2.0, 0.5]))
    with torch.no_grad():
        goal = agent._goal(batch, torch.zeros(CONTROLS))
        agent.reward_scale.copy_(torch.tensor([2.0, 0.0]))
        gained = agent._goal(batch, torch.zeros(CONTROLS))
    r = batch.reward
    assert gained[0] == pytest.approx(float(r[0, 0] + 0.9 * r[0, 1]) / 2.0)
    assert gained[1:].numpy() == pytest.approx(((r[1:, :3] @ torch.tensor([1.0, 0.9, 0.81])) / 2.0).numpy(), abs=1e-5)
    assert goal[0] == gained[0], "nothing follows"
    with torch.no_grad():
        encoder, x = agent.target_actor.encoder, batch.x[:, 3]
        u = torch.tanh(agent.target_actor.mean(encoder(x)))
        value = agent.target_critic.values(agent.target_representation(encoder.features(x), u)).amin(dim=0)
    error = (goal - gained)[1:] - 0.729 * 0.5 / 2.0 * value[1:]
    assert 0.0 < error.abs().max() < 0.05, "but for the noise of the target's actions"


def test_the_first_reward_waits_for_a_scale_of_its_own() -> None:
    agent = some_agent()
    batch = agent._draw(lived(agent), np.random.default_rng(0), None)[1]
    agent.reward_scale.copy_(torch.tensor([1e-8, 1e-8]))  # all rewards have been zero so far
    with torch.no_grad():
        assert not agent._goal(batch._replace(reward=torch.ones_like(batch.reward)), torch.zeros(CONTROLS)).any()
        agent.reward_scale.copy_(torch.tensor([0.5, 1e-8]))
        goal = agent._goal(batch._replace(reward=torch.ones_like(batch.reward)), torch.zeros(CONTROLS))
    assert 1.0 < goal.max() < 10.0, "values learnt so far meant nothing"


def test_an_update_trains_all_networks_follows_with_the_average_and_weighs_what_was_drawn() -> None:
    agent = some_agent()
    replay, generator = lived(agent), torch.Generator().manual_seed(0)
    parts = (agent.actor.encoder.body, agent.actor.encoder.head, agent.representation, agent.critic, agent.averaged)
    before = [weights(part) for part in parts]
    places, errors = [], []
    draw, learn_values = agent._draw, agent._learn_values

    def drawn(*terms: Any) -> Any:
        places.append(draw(*terms))
        return places[-1]

    def noted(*terms: Any) -> Tensor:
        errors.append(learn_values(*terms))
        return errors[-1]

    agent._draw, agent._learn_values = drawn, noted  # type: ignore[method-assign]
    agent.learn(replay, np.random.default_rng(0), generator, None)
    for part, old in zip(parts, before, strict=True):
        assert any(not torch.equal(a, b) for a, b in zip(old, part.parameters(), strict=True))
    (error,), (place, _) = errors, places[-1]
    expected = {int(at): max(float(e), 1.0) ** 0.4 for at, e in zip(place, error, strict=True)}
    assert {at: replay._priority[at] for at in expected} == pytest.approx(expected)


def test_all_encoders_scale_what_is_observed_alike() -> None:
    agent = some_agent()
    lived(agent)
    encoders = (agent.actor.encoder, agent.averaged.encoder, agent.target_actor.encoder)
    assert all(torch.equal(each.middle, encoders[0].middle) for each in encoders)
    assert all(torch.equal(each.unit, encoders[0].unit) for each in encoders)
    assert not torch.equal(encoders[0].unit, torch.ones(SHAPE))


def test_stretches_are_mirrored_where_a_task_has_a_symmetry() -> None:
    """The symmetry changes the sign of u_0; about half of the segments are mirrored."""
    agent = some_agent(batch=500)
    mirror = Mirror(np.arange(SHAPE), np.ones(SHAPE), np.array([-1.0, 1.0]))
    replay = lived(agent)
    plain, mirrored = (agent._draw(replay, np.random.default_rng(0), it)[1] for it in (None, mirror))
    changed = (plain.u[:, :, 0] == -mirrored.u[:, :, 0]).all(dim=1)
    assert 200 < int(changed.sum()) < 300
    assert torch.equal(plain.u[~changed], mirrored.u[~changed])


def test_a_and_b_learn_to_predict_the_next_z() -> None:
    agent = some_agent(model_weight=1e6)  # the value's pull at A and B is nothing beside it
    batch, encoder, lqr = agent._draw(lived(agent), np.random.default_rng(0), None)[1], agent.actor.encoder, agent.lqr
    with torch.no_grad():
        features, z_next = encoder.features(batch.x[:, 0]), encoder(batch.x[:, 1])
    error = lqr.model_loss(encoder.latent(features).detach(), batch.u[:, 0], z_next)
    expected = torch.autograd.grad(error, (lqr.A, lqr.B))
    agent._learn_law(batch, features)
    for parameter, pull in zip((lqr.A, lqr.B), expected, strict=True):
        torch.testing.assert_close(parameter.grad / 1e6, pull, rtol=1e-3, atol=1e-4)


def test_a_first_reward_after_none_leaves_priorities_that_others_can_reach() -> None:
    agent = some_agent(renewal=50)
    random, generator, x = np.random.default_rng(0), torch.Generator().manual_seed(0), np.zeros(SHAPE, np.float32)
    replay = agent.make_replay(INTERFACE, 1000)
    for _ in range(50):
        replay.add(x, np.zeros(CONTROLS, np.float32), 0.0, False)
    agent.learn(replay, random, generator, None)
    for reward in (8.0, 0.0, 0.0, 0.0):
        replay.add(x, np.zeros(CONTROLS, np.float32), reward, False)
    for _ in range(20):
        agent.learn(replay, random, generator, None)
    assert replay._largest < 1e4
    assert len(np.unique(replay.draw_sequences(2000, random).place)) > 10


def test_no_update_is_made_before_there_is_a_whole_stretch() -> None:
    agent = some_agent()
    replay = lived(agent, LENGTH - 1)
    before = weights(agent)
    agent.learn(replay, np.random.default_rng(0), torch.Generator(), None)
    assert all(torch.equal(a, b) for a, b in zip(before, weights(agent), strict=True))
    assert agent.updates == 0


@pytest.mark.parametrize("policy", ["lqr", "network"])
def test_the_deployed_policy_acts_like_the_learnt_one(policy: str) -> None:
    agent = some_agent(policy=policy)
    replay, random, generator = lived(agent), np.random.default_rng(0), torch.Generator().manual_seed(0)
    for _ in range(5):
        agent.learn(replay, random, generator, None)
    controller, x = agent.actor.deploy(), replay.everything().x
    with torch.no_grad():
        expected = torch.tanh(agent.actor.mean(agent.actor.encoder(torch.from_numpy(x)))).numpy()
    u = controller.control(controller.project(controller.encoder(x)))
    assert controller.saturate(u) == pytest.approx(expected, abs=1e-5)
    explored = np.array([agent.act(x[0], generator) for _ in range(2000)])
    assert explored.std(axis=0) == pytest.approx(0.2, abs=0.03)
    assert np.abs(explored).max() <= 1.0


def test_the_law_learns_which_action_pays() -> None:
    """Each episode is one step with a reward for an action near one that depends on the observation."""
    agent = some_agent(hidden=32, renewal=50, learning_rate=3e-3)
    random, generator = np.random.default_rng(0), torch.Generator().manual_seed(0)
    replay = agent.make_replay(INTERFACE, 4000)

    def best(x: np.ndarray) -> np.ndarray:
        return 0.6 * np.tanh(x[..., :CONTROLS])

    for _ in range(1500):
        x, u = random.normal(size=SHAPE).astype(np.float32), random.uniform(-1.0, 1.0, CONTROLS).astype(np.float32)
        agent.meet(x)
        replay.add(x, u, 1.0 - float(np.square(u - best(x)).sum()), True)
        replay.end_episode(x)
    fresh = np.random.default_rng(1).normal(size=(200, SHAPE)).astype(np.float32)

    def distance() -> float:
        controller = agent.actor.deploy()
        u = controller.saturate(controller.control(controller.project(controller.encoder(fresh))))
        return float(np.abs(u - best(fresh)).mean())

    before = distance()
    for _ in range(600):
        agent.learn(replay, random, generator, None)
    assert distance() < 0.35 * before


def test_pictures_and_goals_beyond_the_model_are_refused() -> None:
    with pytest.raises(KoopmanError, match="critic must not be model_based: this task shows pictures"):
        BENCHMARK_TASKS["cartpole_swingup_pixels"].with_settings(critic="model_based")
    with pytest.raises(KoopmanError, match="reward_steps is 6: must be at most model_steps, 5"):
        Settings(critic="model_based", reward_steps=6)
    with pytest.raises(KoopmanError, match="model_steps is 100: must be less than replay, 100"):
        Settings(critic="model_based", model_steps=100, replay=100)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no GPU")
@pytest.mark.parametrize("goal", [None, GOAL])
def test_a_gpu_learns_the_same_by_graphs_as_by_single_kernels_and_as_a_cpu(
    goal: np.ndarray | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def learnt(device: str, eager_calls: int) -> tuple[np.ndarray, list[Tensor]]:
        monkeypatch.setattr(cuda_graph, "_EAGER_CALLS", eager_calls)
        agent = some_agent(goal, device, renewal=5)
        replay, random, generator = lived(agent), np.random.default_rng(0), torch.Generator().manual_seed(0)
        actions = []
        for _ in range(20):
            agent.learn(replay, random, generator, None)
            agent.meet(random.normal(size=SHAPE))
            actions.append(agent.act(random.normal(size=SHAPE).astype(np.float32), generator))
        assert (agent._mean._graph is None) == (device == "cpu" or eager_calls > 20)
        return np.array(actions), weights(agent.averaged)

    (by_graphs, graph_weights), (one_by_one, single_weights) = learnt("cuda", 3), learnt("cuda", 1000)
    on_cpu, _ = learnt("cpu", 3)
    assert by_graphs == pytest.approx(one_by_one, abs=1e-4)
    for a, b in zip(graph_weights, single_weights, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-4)
    assert by_graphs == pytest.approx(on_cpu, abs=0.02)  # Adam makes steps of one size of gradients near 0

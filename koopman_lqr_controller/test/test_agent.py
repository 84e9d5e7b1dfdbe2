"""Updates of the agent: the parameters moved by each loss, its actions, and its deployed policy."""

import numpy as np
import pytest
import torch
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.agents.actor import AgentInterface
from koopman_lqr_controller.training.agents.soft_agent import SoftAgent
from koopman_lqr_controller.training.environments.benchmark_tasks import BENCHMARK_TASKS
from koopman_lqr_controller.training.networks.encoder_losses import EncoderBatch
from koopman_lqr_controller.training.replay import Transitions
from koopman_lqr_controller.training.settings import Settings

ENCODER_LOSSES = ("contrastive", "reconstruction", "reconstruction_prediction")


def some_agent(shape: tuple[int, ...] = (3,), **changes: object) -> tuple[SoftAgent, Transitions]:
    settings = Settings(**{"hidden": 16, "latent": 5, "batch": 32, **changes})
    goal = None if len(shape) > 1 else np.array([0.0, 1.0, 0.0], np.float32)
    interface = AgentInterface(shape, 2, np.zeros((), np.float32), np.ones((), np.float32), goal)
    random = np.random.default_rng(0)
    x, x_next = random.normal(size=(2, 32, *shape)).astype(np.float32)
    u, reward = random.uniform(-1, 1, (32, 2)).astype(np.float32), random.normal(size=32).astype(np.float32)
    return SoftAgent(interface, settings, seed=0), Transitions(x, u, reward, x_next, np.zeros(32, np.float32))


@pytest.mark.parametrize("encoder_loss", ENCODER_LOSSES)
def test_each_loss_moves_what_it_should_and_nothing_else(encoder_loss: str) -> None:
    agent, data = some_agent(encoder_loss=encoder_loss)
    generator = torch.Generator().manual_seed(0)
    parts = {"encoder": agent.actor.encoder, "critic": agent.critic, "lqr": agent.actor.lqr}
    x, u, reward, x_next, end = (torch.from_numpy(part) for part in data[:5])

    def moved(learn) -> set[str]:
        before = {name: [p.clone() for p in part.parameters()] for name, part in parts.items()}
        learn()
        return {
            name
            for name, part in parts.items()
            if any(not torch.equal(a, b) for a, b in zip(before[name], part.parameters(), strict=True))
        }

    def critic() -> dict[str, torch.Tensor]:
        with torch.no_grad():
            value = agent._soft_value(agent.actor.encoder(x_next), x_next, generator)
        return {"critic": agent.critic.loss(agent.actor.encoder(x), u, reward + (1.0 - end) * value)}

    def encoder() -> dict[str, torch.Tensor]:
        seen = EncoderBatch(x, x, u, x_next, agent.key_encoder, agent.lqr)
        return {"encoder": agent.encoder_loss(agent.actor.encoder(x), seen)}

    z = agent.actor.encoder(x).detach()
    assert moved(lambda: agent._step(critic())) == {"encoder", "critic"}
    assert moved(lambda: agent._step(encoder())) == {"encoder"}
    assert moved(lambda: agent._step({"model": agent.actor.lqr.model_loss(z, u, z)})) == {"lqr"}
    assert moved(lambda: agent._step(agent._actor_losses(agent.actor.encoder(x), x, generator))) == {"encoder", "lqr"}


def test_critics_of_observations_leave_the_encoder_alone() -> None:
    agent, data = some_agent(critic_input="observation", encoder_loss="nothing", actor_every=1000)
    agent.updates = 1  # no turn of the actor's
    generator = torch.Generator().manual_seed(0)
    encoder, critic = ([p.clone() for p in part.parameters()] for part in (agent.actor.encoder, agent.critic))
    agent.update(data, generator)
    assert all(torch.equal(*each) for each in zip(encoder, agent.actor.encoder.parameters(), strict=True))
    assert not any(torch.equal(*each) for each in zip(critic, agent.critic.parameters(), strict=True))
    agent._step(agent._actor_losses(agent.actor.encoder(torch.from_numpy(data.x)), torch.from_numpy(data.x), generator))
    assert not any(torch.equal(*each) for each in zip(encoder[:2], agent.actor.encoder.parameters(), strict=False))


def test_the_model_loss_may_join_the_steps_of_the_actor() -> None:
    agent, data = some_agent(critic_input="observation", encoder_loss="nothing", actor_every=1, model_weight=1e6)
    x, u, _, x_next, _ = (torch.from_numpy(part) for part in data[:5])
    encoder, A = agent.actor.encoder, agent.lqr.A
    with torch.no_grad():
        z, z_next = encoder(x), encoder(x_next)
    (slope,) = torch.autograd.grad(agent.lqr.model_loss(z, u, z_next), A)
    before = A.detach().clone()
    agent.update(data, torch.Generator().manual_seed(0))
    assert torch.equal(torch.sign(A.detach() - before), -torch.sign(slope)), "it outweighs the value"
    assert not agent.optimizers["model"].state, "no step of its own"


def test_observations_are_scaled_by_what_was_seen_in_the_deployed_policy_too() -> None:
    agent, _ = some_agent(scale="seen", critic_input="observation")
    met = np.random.default_rng(3).normal((5.0, -200.0, 0.0), (1.0, 30.0, 0.0), (200, 3)).astype(np.float32)
    for x in met:
        agent.meet(x)
    expected = (met - met.mean(axis=0, dtype=float)) / (met.std(axis=0, dtype=float) + 1e-3)
    for encoder in (agent.actor.encoder, agent.averaged.encoder, agent.key_encoder):
        assert encoder.normalise(torch.from_numpy(met)).numpy() == pytest.approx(expected, abs=1e-4)
    learnt = agent.actor.encoder(torch.from_numpy(met)).detach().numpy()
    assert agent.actor.deploy().encoder(met) == pytest.approx(learnt, abs=1e-5)


@pytest.mark.parametrize("change", [{"critic_input": "observation"}, {"scale": "seen"}])
def test_pictures_are_seen_by_their_encoder_alone(change: dict[str, str]) -> None:
    with pytest.raises(KoopmanError, match="critic_input must be latent and scale task: this task shows pictures"):
        BENCHMARK_TASKS["cartpole_swingup_pixels"].with_settings(**change)


@pytest.mark.parametrize("shape", [(3,), (2, 26, 26)])
@pytest.mark.parametrize("encoder_loss", [*ENCODER_LOSSES, "nothing"])
def test_updates_of_vectors_and_images_are_finite_and_the_average_follows(
    encoder_loss: str, shape: tuple[int, ...]
) -> None:
    agent, data = some_agent(shape, encoder_loss=encoder_loss, **({"crop": 24, "depth": 3} if shape[1:] else {}))
    generator = torch.Generator().manual_seed(0)
    first = agent.averaged.lqr.A.clone()
    for _ in range(4):
        agent.update(data, generator)
    assert agent.updates == 4
    assert all(torch.isfinite(p).all() for p in agent.parameters())
    assert 0 < (agent.averaged.lqr.A - first).abs().max() < (agent.actor.lqr.A - first).abs().max()


def test_the_density_of_an_action_is_that_of_a_squashed_normal() -> None:
    agent, _ = some_agent()
    z = torch.randn(1, 5, generator=torch.Generator().manual_seed(1)).expand(20_000, 5)
    u, log_density = agent.actor.sample(z, torch.Generator().manual_seed(0))
    mean = agent.actor.mean(z)
    normal = torch.distributions.Normal(mean, agent.actor.log_deviation.exp())
    squashed = torch.distributions.TransformedDistribution(normal, torch.distributions.TanhTransform(cache_size=1))
    inside = (u.abs() < 0.99).all(dim=1)
    expected = squashed.log_prob(u).sum(dim=1)
    assert log_density[inside].detach().numpy() == pytest.approx(expected[inside].detach().numpy(), abs=1e-2)


@pytest.mark.parametrize("deviation", [0.01, 1.0, 2.5])
def test_the_deviation_of_the_controls_can_always_move(deviation: float) -> None:
    agent, _ = some_agent(deviation=deviation)
    assert agent.actor.log_deviation.exp().item() == pytest.approx(deviation)
    with torch.no_grad():
        agent.actor.raw_deviation.mul_(2.0)  # towards a limit
    agent.actor.log_deviation.sum().backward()
    assert agent.actor.raw_deviation.grad.abs().item() > 1e-3
    with pytest.raises(KoopmanError, match=r"deviation is 3\.0: must lie between"):
        some_agent(deviation=3.0)


@pytest.mark.parametrize("policy", ["lqr", "network"])
def test_the_deployed_policy_acts_like_the_learnt_one(policy: str) -> None:
    agent, data = some_agent(policy=policy)
    controller = agent.actor.deploy()
    x = torch.from_numpy(data.x)
    expected = torch.tanh(agent.actor.mean(agent.actor.encoder(x))).detach().numpy()
    u = controller.control(controller.project(controller.encoder(data.x)))
    assert controller.saturate(u) == pytest.approx(expected, abs=1e-5)


def test_the_encoder_of_images_hears_its_own_loss_beside_values_that_are_large() -> None:
    settings = Settings(latent=8, hidden=16, depth=2, crop=20, batch=32, learning_rate=1e-3)
    grey = np.array(127.5, np.float32)
    agent = SoftAgent(AgentInterface((3, 24, 24), 1, grey, grey, None), settings, seed=0)
    random, generator = np.random.default_rng(0), torch.Generator().manual_seed(0)
    pictures = random.integers(0, 255, (32, 3, 6, 6)).repeat(4, axis=2).repeat(4, axis=3).astype(np.uint8)
    batch = Transitions(
        x=pictures,
        u=random.uniform(-1.0, 1.0, (32, 1)).astype(np.float32),
        reward=1000.0 * random.normal(size=32).astype(np.float32),
        x_next=pictures[::-1].copy(),
        terminated=np.zeros(32, np.float32),
    )

    def contrast() -> float:
        x = torch.from_numpy(pictures)
        seen = EncoderBatch(x, x, torch.from_numpy(batch.u), x, agent.key_encoder, agent.lqr)
        with torch.no_grad():
            return float(agent.encoder_loss(agent.actor.encoder(x), seen))

    before = contrast()
    for _ in range(100):
        agent.update(batch, generator)
    assert contrast() < 0.5 * before

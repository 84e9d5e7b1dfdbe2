"""The model of the features of values: its loss, and that it learns to predict."""

import torch
from koopman_lqr_controller.training.networks.representation import Representation
from koopman_lqr_controller.training.networks.two_hot import two_hot
from torch import Tensor

FEATURES, CONTROLS, HORIZON = 4, 2, 3


def stretch(rows: int = 16, seed: int = 0) -> tuple[Tensor, ...]:
    """Return random features, actions, rewards and later features without terminations."""
    generator = torch.Generator().manual_seed(seed)
    features = torch.randn(rows, FEATURES, generator=generator)
    u = 2.0 * torch.rand(rows, HORIZON, CONTROLS, generator=generator) - 1.0
    reward = torch.randn(rows, HORIZON, generator=generator)
    return features, u, reward, torch.randn(rows, HORIZON, FEATURES, generator=generator), torch.ones(rows, HORIZON)


def some_representation() -> Representation:
    torch.manual_seed(0)
    return Representation(FEATURES, CONTROLS, 32)


def test_what_comes_after_an_end_does_not_count() -> None:
    model = some_representation()
    features, u, reward, later, goes_on = stretch()
    goes_on[:, 1] = 0.0
    loss = model.loss(features, u, reward, later, goes_on)
    u[:, 2], reward[:, 2], later[:, 2] = 0.5, 100.0, 100.0
    torch.testing.assert_close(model.loss(features, u, reward, later, goes_on), loss)
    goes_on[:, 2] = 0.0
    torch.testing.assert_close(model.loss(features, u, reward, later, goes_on), loss)
    later[:, 1] += 1.0
    assert model.loss(features, u, reward, later, goes_on) > loss, "the last observation itself does"


def test_the_loss_is_the_sum_over_steps_of_what_is_predicted_from_what_was_predicted() -> None:
    model = some_representation()
    torch.nn.init.normal_(model.end.weight)
    features, u, reward, later, goes_on = stretch()
    goes_on[:8, -1] = 0.0
    expected, at = torch.zeros(()), features
    for step in range(HORIZON):
        pair = model(at, u[:, step])
        told, end = model.head(pair), model.end(pair)[:, 0]
        at, logits = told[:, :FEATURES], told[:, FEATURES:]
        shares = two_hot(reward[:, step], model.bins)
        entropy = -(shares * torch.log_softmax(logits, dim=1)).sum(dim=1)
        end_error = (end - (1.0 - goes_on[:, step])).square()
        expected = expected + (at - later[:, step]).square().mean() + 0.1 * (entropy + end_error).mean()
    torch.testing.assert_close(model.loss(features, u, reward, later, goes_on), expected)


def test_it_learns_to_look_ahead() -> None:
    """For a linear system, several steps ahead, on unseen segments."""
    generator = torch.Generator().manual_seed(1)
    A, B = (
        0.5 * torch.randn(FEATURES, FEATURES, generator=generator),
        torch.randn(CONTROLS, FEATURES, generator=generator),
    )

    def lived(seed: int) -> tuple[Tensor, ...]:
        features, u, _, later, goes_on = stretch(256, seed)
        at = features
        for step in range(HORIZON):
            at = at @ A + u[:, step] @ B
            later[:, step] = at
        return features, u, later.sum(dim=2), later, goes_on

    model = some_representation()
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    with torch.no_grad():
        before = model.loss(*lived(1000))
    for seed in range(300):
        optimizer.zero_grad()
        model.loss(*lived(seed)).backward()
        optimizer.step()
    with torch.no_grad():
        assert model.loss(*lived(1000)) < 0.2 * before


def test_it_learns_when_an_episode_ends_and_expects_no_end_before_one_was_met() -> None:
    """An episode ends where the first feature exceeds a bound."""
    model = some_representation()
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)

    def lived(seed: int) -> tuple[Tensor, Tensor, Tensor]:
        features, u, *_ = stretch(256, seed)
        return features, u, (features[:, 0] < 0.5).float()

    features, u, goes_on = lived(1000)
    assert torch.equal(model.end(model(features, u[:, 0])), torch.zeros(256, 1))
    for seed in range(300):
        began, actions, on = lived(seed)
        optimizer.zero_grad()
        zeros = torch.zeros(256, 1)
        model.loss(began, actions[:, :1], zeros, began[:, None], on[:, None]).backward()
        optimizer.step()
    with torch.no_grad():
        expected = model.end(model(features, u[:, 0]))[:, 0]
    assert ((expected > 0.5) == (goes_on == 0.0)).float().mean() > 0.95


def test_half_the_bits_give_nearly_the_same_loss() -> None:
    def loss(halved: bool) -> Tensor:
        torch.manual_seed(0)
        return Representation(FEATURES, CONTROLS, 32, halved).loss(*stretch())

    assert 0.0 < (loss(True) - loss(False)).abs() < 0.02 * loss(False)

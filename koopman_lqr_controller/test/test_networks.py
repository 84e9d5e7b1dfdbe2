"""The critics against networks of torch's own modules."""

import pytest
import torch
from koopman_lqr_controller.training.networks.critics import TwinCritic
from torch import Tensor, nn

LATENT, CONTROLS, HIDDEN = 5, 2, 16


def inputs(rows: int = 64) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    z = torch.randn(rows, LATENT, generator=generator)
    return z, 2.0 * torch.rand(rows, CONTROLS, generator=generator) - 1.0


def alone(critic: TwinCritic, index: int, normalised: bool) -> nn.Sequential:
    """Return one of the two critics, built from torch's own layers."""
    layers: list[nn.Module] = []
    last = len(critic.weights) - 1
    for number, (weight, bias) in enumerate(zip(critic.weights, critic.biases, strict=True)):
        layer = nn.Linear(weight.shape[1], weight.shape[2])
        with torch.no_grad():
            layer.weight.copy_(weight[index].T)
            layer.bias.copy_(bias[index, 0])
        layers.append(layer)
        if number < last:
            layers += [nn.LayerNorm(weight.shape[2]), nn.ReLU()] if normalised else [nn.ReLU()]
    return nn.Sequential(*layers)


@pytest.mark.parametrize("depth", [2, 3])
@pytest.mark.parametrize("normalised", [False, True])
def test_two_critics_at_once_are_two_critics(normalised: bool, depth: int) -> None:
    torch.manual_seed(0)
    critic = TwinCritic(LATENT, CONTROLS, HIDDEN, normalised, depth=depth)
    z, u = inputs()
    for index, values in enumerate(critic(z, u)):
        torch.testing.assert_close(values, alone(critic, index, normalised)(torch.cat((z, u), dim=1)).squeeze(1))


@pytest.mark.parametrize("normalised", [False, True])
def test_half_the_bits_give_nearly_the_same_values_and_gradients(normalised: bool) -> None:
    def computed(halved: bool) -> tuple[Tensor, ...]:
        torch.manual_seed(0)
        critic = TwinCritic(LATENT, CONTROLS, HIDDEN, normalised, halved)
        values = critic(*inputs())
        values.square().mean().backward()
        return values.detach(), *(weight.grad for weight in critic.weights if weight.grad is not None)

    for exact, halved in zip(computed(False), computed(True), strict=True):
        assert halved.dtype == torch.float32
        assert 0.0 < (halved - exact).norm() < 0.1 * exact.norm()


def test_normalised_values_cannot_run_away() -> None:
    z, u = inputs()

    def largest(normalised: bool, factor: float) -> float:
        torch.manual_seed(0)
        with torch.no_grad():
            return float(TwinCritic(LATENT, CONTROLS, HIDDEN, normalised)(factor * z, factor * u).abs().max())

    assert largest(False, 1e6) > 1e4 * largest(False, 1.0)
    assert largest(True, 1e6) < 3.0 * largest(True, 1.0)

"""SAC's two critics, computed jointly: plain hidden layers, or residual layers with a distribution of values.

The second kind is trained by cross entropy, whose gradients do not grow with the value (Farebrother et al. 2024); its
normalised residual layers tolerate several updates per action (Nauman et al. 2024; Lee et al. 2025).
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import layer_norm

from koopman_lqr_controller.training.networks.two_hot import cross_entropy, symmetric_bins
from koopman_lqr_controller.training.settings import Settings

_BLOCKS = 2
_BINS = 101
_LARGEST = 8.0
"""Symmetric logarithm of the maximum representable value, about 3000."""


class _Twin(nn.Module):
    """Linear layers of two networks at once.

    Args:
        sizes: Numbers of inputs and outputs of each layer.
        halved: Whether all layers but the last are computed in bfloat16.
    """

    def __init__(self, sizes: list[tuple[int, int]], halved: bool) -> None:
        super().__init__()
        self._kind = torch.bfloat16 if halved else torch.float32
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for inputs, outputs in sizes:
            reach = inputs**-0.5
            self.weights.append(nn.Parameter((2.0 * torch.rand(2, inputs, outputs) - 1.0) * reach))
            self.biases.append(nn.Parameter((2.0 * torch.rand(2, 1, outputs) - 1.0) * reach))

    def _layer(self, number: int, x: Tensor) -> Tensor:
        kind = x.dtype
        return torch.baddbmm(self.biases[number].to(kind), x, self.weights[number].to(kind))

    def _inputs(self, x: Tensor) -> Tensor:
        return x.expand(2, -1, -1).to(self._kind)


class TwinCritic(_Twin):
    """Q_1 and Q_2 of Eq. 4.10, with plain hidden layers.

    Args:
        inputs: Dimension of the critics' state.
        controls: Number of controls; 0 if the state includes the action.
        hidden: Number of units of each hidden layer.
        normalised: Whether hidden layers have a parameter-free LayerNorm before their ReLU.
        halved: Whether hidden layers are computed in bfloat16.
        depth: Number of hidden layers.
    """

    def __init__(
        self,
        inputs: int,
        controls: int,
        hidden: int,
        normalised: bool = False,
        halved: bool = False,
        depth: int = 2,
    ) -> None:
        super().__init__(list(pairwise((inputs + controls, *[hidden] * depth, 1))), halved)
        self._normalised, self._depth = normalised, depth

    def forward(self, z: Tensor, u: Tensor) -> Tensor:
        """Return both values (2, N) of states (N, n) and actions (N, m)."""
        return self.values(torch.cat((z, u), dim=1))

    def values(self, x: Tensor) -> Tensor:
        """Return both values (2, N) of concatenated states and actions (N, n + m)."""
        x = self._inputs(x)
        for number in range(self._depth):
            x = self._layer(number, x)
            x = torch.relu(layer_norm(x, x.shape[-1:]) if self._normalised else x)
        return self._layer(self._depth, x.float()).squeeze(-1)

    def loss(self, z: Tensor, u: Tensor, goal: Tensor) -> Tensor:
        """Return the mean squared error of both values against targets (N,), summed over the two."""
        return (self(z, u) - goal).square().mean(dim=1).sum()


class CategoricalCritic(_Twin):
    """Q_1 and Q_2 of Eq. 4.10 as means of categorical distributions, with normalised residual layers.

    Args:
        inputs: Dimension of the critics' state.
        controls: Number of controls.
        hidden: Number of units of each hidden layer.
        halved: Whether hidden layers are computed in bfloat16.
    """

    bins: Tensor

    def __init__(self, inputs: int, controls: int, hidden: int, halved: bool = False) -> None:
        sizes = [(inputs + controls, hidden), *[(hidden, hidden)] * (2 * _BLOCKS), (hidden, _BINS)]
        super().__init__(sizes, halved)
        with torch.no_grad():
            self.weights[-1].zero_()
            self.biases[-1].zero_()
        self.register_buffer("bins", symmetric_bins(_LARGEST, _BINS))

    def forward(self, z: Tensor, u: Tensor) -> Tensor:
        """Return both values (2, N) of states (N, n) and actions (N, m)."""
        values: Tensor = torch.softmax(self._logits(z, u), dim=-1) @ self.bins
        return values

    def loss(self, z: Tensor, u: Tensor, goal: Tensor) -> Tensor:
        """Return the cross entropy of both distributions against targets (N,), summed over the two."""
        return cross_entropy(self._logits(z, u), goal.expand(2, -1), self.bins).mean(dim=1).sum()

    def _logits(self, z: Tensor, u: Tensor) -> Tensor:
        x = self._inputs(torch.cat((z, u), dim=1))
        x = torch.relu(_normalised(self._layer(0, x)))
        for first in range(1, 2 * _BLOCKS, 2):
            inner = torch.relu(_normalised(self._layer(first, x)))
            x = x + _normalised(self._layer(first + 1, inner))
        return self._layer(2 * _BLOCKS + 1, x.float())


def _normalised(x: Tensor) -> Tensor:
    return layer_norm(x, x.shape[-1:])


def make_critic(observed: int, controls: int, settings: Settings) -> TwinCritic | CategoricalCritic:
    """Create the untrained critics selected by the settings, for observations (observed,) or z."""
    inputs = observed if settings.critic_input == "observation" else settings.latent
    sizes, halved = (inputs, controls, settings.hidden), settings.bfloat16 == "all"
    if settings.critic == "categorical":
        return CategoricalCritic(*sizes, halved)
    return TwinCritic(*sizes, settings.critic == "layer_norm", halved)

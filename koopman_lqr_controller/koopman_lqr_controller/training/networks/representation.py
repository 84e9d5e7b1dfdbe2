"""An auxiliary model for representation learning: embeddings of states, and of states with actions.

From the latter, linear layers predict the next embedding, the reward and the end of the episode, several steps ahead
(MR.Q; Fujimoto et al. 2025). Values depend on the same information, which is learnt here from every step rather than
only from those with rewards.
"""

from __future__ import annotations

from typing import TypeAlias

import torch
from torch import Tensor, nn
from torch.nn.functional import layer_norm, linear

from koopman_lqr_controller.training.networks.two_hot import cross_entropy, symmetric_bins

_BINS = 65
_LARGEST = 10.0
"""Symmetric logarithm of the maximum representable reward, about 22,000."""
_REWARD_WEIGHT = 0.1
_END_WEIGHT = 0.1
_Layer: TypeAlias = tuple[Tensor, Tensor]


class Representation(nn.Module):
    """Embedding of states with actions, and its linear prediction.

    Args:
        features: Dimension of a state's embedding.
        controls: Number of controls.
        hidden: Number of units of each hidden layer, and dimension of the embedding of a state with an action.
        halved: Whether everything but the losses is computed in bfloat16.
    """

    bins: Tensor

    def __init__(self, features: int, controls: int, hidden: int, halved: bool = False) -> None:
        super().__init__()
        self._kind = torch.bfloat16 if halved else torch.float32
        self.action = nn.Linear(controls, hidden // 2)
        self.body = nn.ModuleList((nn.Linear(features + hidden // 2, hidden), nn.Linear(hidden, hidden)))
        self.last = nn.Linear(hidden, hidden)
        self.head = nn.Linear(hidden, features + _BINS)
        self.end: nn.Linear = nn.utils.skip_init(nn.Linear, hidden, 1)  # type: ignore[no-untyped-call]
        for parameter in self.end.parameters():
            nn.init.zeros_(parameter)  # predicts no end of the episode initially
        self.register_buffer("bins", symmetric_bins(_LARGEST, _BINS))

    def forward(self, features: Tensor, u: Tensor) -> Tensor:
        """Return the embedding (N, hidden) of states, given by features (N, k), with actions (N, m)."""
        return self._embedding(features.to(self._kind), u.to(self._kind), *self._layers())

    def loss(self, features: Tensor, u: Tensor, reward: Tensor, later: Tensor, goes_on: Tensor) -> Tensor:
        """Return the error of predicted embeddings, rewards and ends, summed over H steps.

        Args:
            features: Embeddings of the initial states (N, k).
            u: Actions (N, H, m).
            reward: Reward of each step (N, H).
            later: Embeddings of the states after each step (N, H, k).
            goes_on: Whether the episode continues after each step, 0 or 1 (N, H); steps after its end are ignored.
        """
        layers, head, end = self._layers(), self._rounded(self.head), self._rounded(self.end)
        features, actions, size = features.to(self._kind), u.to(self._kind), features.shape[1]
        counts, total = torch.ones_like(goes_on[:, 0]), torch.zeros((), device=goes_on.device)
        for step in range(u.shape[1]):
            pair = self._embedding(features, actions[:, step], *layers)
            told, expected_end = linear(pair, *head), linear(pair, *end).squeeze(1).float()
            features = told[:, :size]
            embedding_error = (features.float() - later[:, step]).square().mean(dim=1)
            reward_error = cross_entropy(told[:, size:].float(), reward[:, step], self.bins)
            end_error = (expected_end - (1.0 - goes_on[:, step])).square()
            error = embedding_error + _REWARD_WEIGHT * reward_error + _END_WEIGHT * end_error
            total = total + (counts * error).mean()
            counts = counts * goes_on[:, step]
        return total

    def _embedding(self, features: Tensor, u: Tensor, action: _Layer, *body: _Layer) -> Tensor:
        x = torch.cat((features, torch.relu(linear(u, *action))), dim=1)
        for weights, biases in body[:-1]:
            x = torch.relu(layer_norm(linear(x, weights, biases), biases.shape))
        return linear(x, *body[-1])

    def _layers(self) -> tuple[_Layer, ...]:
        return tuple(self._rounded(layer) for layer in (self.action, *self.body, self.last))

    def _rounded(self, layer: nn.Module) -> _Layer:
        """Return weights and biases in the precision of the computation, converted once for all steps to save time."""
        assert isinstance(layer, nn.Linear)
        return layer.weight.to(self._kind), layer.bias.to(self._kind)

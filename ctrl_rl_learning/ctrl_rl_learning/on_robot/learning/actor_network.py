"""The network of a policy's file, as torch trains it: the same numbers before, and a file of the same kind after."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import layer_norm, linear

from ctrl_rl_core import Actor, PolicyManifest


class ActorNetwork(nn.Module):
    """The network of an actor: observations (N, n) in the network's units to actions (N, 2) in [-1, 1]."""

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self._actor = actor
        self._kind = actor.activation.removeprefix("normalized_")
        self.weights = nn.ParameterList(torch.tensor(each) for each in actor.weights)
        self.biases = nn.ParameterList(torch.tensor(each) for each in actor.biases)

    def forward(self, x: Tensor) -> Tensor:
        """Return the actions; where an actor cuts them off, gradients pass as if it did not."""
        for index, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = linear(x, weight, bias)
            if index < len(self.weights) - 1:
                if self._kind != self._actor.activation:
                    x = layer_norm(x, x.shape[-1:])
                x = torch.tanh(x) if self._kind == "tanh" else torch.relu(x)
        return torch.tanh(x) if self._actor.squashed else x + (x.clamp(-1.0, 1.0) - x).detach()

    def to_actor(self, manifest: Mapping[str, Any]) -> Actor:
        """Return the policy as it stands, with more in its manifest."""
        return replace(
            self._actor,
            weights=tuple(each.detach().numpy().copy() for each in self.weights),
            biases=tuple(each.detach().numpy().copy() for each in self.biases),
            manifest={**self._actor.manifest, **manifest},
        )


def widen(actor: Actor, interface: PolicyManifest, units: np.ndarray[Any, np.dtype[np.float32]]) -> Actor:
    """Return an actor of an interface that observes more at its end; until it learns, it does what it did.

    Args:
        actor: Actor of the shorter observation.
        interface: Interface of the longer one.
        units: Distance above 0 that becomes 1, of each number that is added (added,).
    """
    added = np.zeros((len(actor.weights[0]), len(units)), np.float32)
    return replace(
        actor,
        weights=(np.concatenate((actor.weights[0], added), axis=1), *actor.weights[1:]),
        middle=np.concatenate((actor.middle, np.zeros(len(units), np.float32))),
        unit=np.concatenate((actor.unit, units)),
        interface=interface,
    )

"""Base class of agents: an actor with its average, observation scales, and optimiser steps."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from itertools import chain

import numpy as np
import torch
from ctrl_rl_learning.torch import gradient_step
from numpy.typing import NDArray
from torch import Tensor, nn

from koopman_lqr_controller.training.agents.actor import AgentInterface, LqrActor, NetworkActor, make_actor
from koopman_lqr_controller.training.agents.cuda_graph import Graphed
from koopman_lqr_controller.training.networks.differentiable_lqr import LatentLqr
from koopman_lqr_controller.training.networks.networks import RunningScale, TorchEncoder
from koopman_lqr_controller.training.replay import Mirror, Replay
from koopman_lqr_controller.training.settings import Settings


class Agent(nn.Module, ABC):
    """Networks to learn, and their updates.

    Args:
        interface: Observations and controls.
        settings: Hyperparameters of networks, replay and updates.
        seed: Random seed of all weights.
        device: Device of the networks.

    Attributes:
        actor: Current actor.
        averaged: Exponential average of `actor` over updates.
        optimizers: Optimisers by name.
        updates: Number of updates so far.
    """

    actor: LqrActor | NetworkActor
    averaged: LqrActor | NetworkActor
    optimizers: dict[str, torch.optim.Optimizer]

    def __init__(self, interface: AgentInterface, settings: Settings, seed: int, device: str = "cpu") -> None:
        super().__init__()
        self.settings, self._device, self.updates = settings, torch.device(device), 0
        self._noted: dict[str, tuple[Tensor, Tensor]] = {}
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.actor = make_actor(interface, settings)
            self._make_networks(interface)
        self.averaged = copy.deepcopy(self.actor).requires_grad_(False)
        self.scale = RunningScale(interface.shape[0]) if settings.scale == "seen" else None
        self._add_to_scale = Graphed(self._rescale, self._device)

    @abstractmethod
    def _make_networks(self, interface: AgentInterface) -> None:
        """Create all networks besides the actor; random numbers come from the seed."""

    @abstractmethod
    def make_replay(self, interface: AgentInterface, capacity: int) -> Replay:
        """Create an empty replay for `learn`."""

    @abstractmethod
    def act(self, x: NDArray[np.generic], generator: torch.Generator) -> NDArray[np.float32]:
        """Return an action (m,) for an observation (*shape), with exploration noise."""

    @abstractmethod
    def learn(
        self, replay: Replay, random: np.random.Generator, generator: torch.Generator, mirror: Mirror | None
    ) -> None:
        """Do one update.

        Args:
            replay: Replay of `make_replay`.
            random: Generator for sampling from the replay.
            generator: Generator of all noise, on the CPU.
            mirror: Symmetry of the task, or None.
        """

    @abstractmethod
    def _scaled_encoders(self) -> Iterable[TorchEncoder]:
        """Return all encoders with an observation scale."""

    @property
    def lqr(self) -> LatentLqr | None:
        """A, B, Q, R; None for a network actor."""
        return self.actor.lqr if isinstance(self.actor, LqrActor) else None

    def meet(self, x: NDArray[np.generic]) -> None:
        """Record an observation (*shape), which matters only if the scale is estimated from observations."""
        if self.scale is not None:
            self._add_to_scale(torch.from_numpy(np.asarray(x, np.float64)))

    def _rescale(self, x: Tensor) -> Tensor:
        """Add an observation (n,) to the scale and update all encoders; return the number of observations."""
        assert self.scale is not None
        self.scale.add(x)
        self.scale.give(self._scaled_encoders())
        return self.scale.count

    def _adam(self, parameters: Iterable[nn.Parameter], rate: float | None = None) -> torch.optim.Optimizer:
        rate = self.settings.learning_rate if rate is None else rate
        return torch.optim.Adam(list(parameters), lr=rate, fused=True, capturable=self._device.type == "cuda")

    def _step(self, losses: Mapping[str, Tensor]) -> None:
        """Minimise losses, given by optimiser name, with one backward pass."""
        gradient_step([self.optimizers[name] for name in losses], list(losses.values()))
        self._note({f"{name}_loss": loss.detach() for name, loss in losses.items()})

    def _note(self, figures: Mapping[str, Tensor]) -> None:
        """Add metrics of an update to the sums averaged by `take_losses`."""
        for name, figure in figures.items():
            if name not in self._noted:
                self._noted[name] = (torch.zeros_like(figure), torch.zeros_like(figure))
            total, count = self._noted[name]  # in place, because a recorded CUDA graph repeats it
            total.add_(figure)
            count.add_(1.0)

    def take_losses(self) -> dict[str, float]:
        """Return the mean losses since the last call by name, and the policy's `entropy` if it has one."""
        means = {name: float(total / count) for name, (total, count) in self._noted.items() if count}
        for each in chain.from_iterable(self._noted.values()):
            each.zero_()
        return {"loss": means["critic_loss"], **means} if "critic_loss" in means else means

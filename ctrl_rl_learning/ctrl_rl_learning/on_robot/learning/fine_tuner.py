"""Fine-tuning of a policy from few steps: TD3 with several updates a step, near the policy that it began with.

The first steps teach the critics alone. Then the actor climbs them, held to what the first policy would have done by a
weight that fades, and to what the operator did wherever he took over.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import mse_loss

from ctrl_rl_core import Actor
from ctrl_rl_learning.offline.learners.networks import Critics, track
from ctrl_rl_learning.on_robot.learning.actor_network import ActorNetwork
from ctrl_rl_learning.on_robot.learning.replay import Replay
from ctrl_rl_learning.torch.learner_state import restore_state, state_arrays

Vector = NDArray[np.float32]
_TAU = 0.005
_NOISE, _NOISE_LIMIT, _DELAY = 0.2, 0.5, 2  # TD3's


@dataclass(frozen=True)
class TuneSettings:
    """Settings of fine-tuning.

    Attributes:
        updates: Number of updates of the critics for each step of the robot.
        first_updates: Number of updates of the critics alone before the actor begins to learn.
        first_steps: Number of steps before that.
        noise: Standard deviation of the exploration, in actions.
        discount: Discount of a step of the usual length.
        batch: Steps in an update.
        hidden: Units of each hidden layer of the critics.
        actor_rate: Learning rate of the actor.
        critic_rate: Learning rate of the critics.
        hold: Weight that holds the actor to the first policy, when it begins to learn.
        hold_at_last: The same weight after `fading` steps.
        fading: Number of steps in which that weight fades.
    """

    updates: int = 5
    first_updates: int = 2000
    first_steps: int = 600
    noise: float = 0.25
    discount: float = 0.97
    batch: int = 256
    hidden: int = 128
    actor_rate: float = 3e-4
    critic_rate: float = 1e-3
    hold: float = 1.0
    hold_at_last: float = 0.1
    fading: int = 2000


class FineTuner:
    """A policy that learns from a replay of steps."""

    def __init__(self, actor: Actor, settings: TuneSettings, capacity: int, seed: int) -> None:
        """Begin with a policy.

        Args:
            actor: Policy to begin with.
            settings: Settings of learning.
            capacity: Largest number of steps that are kept.
            seed: Seed of networks and batches.
        """
        torch.manual_seed(seed)
        self.settings = settings
        self.replay = Replay(capacity, len(actor.middle))
        self._middle, self._unit = actor.middle, actor.unit
        self._actor, self._first = ActorNetwork(actor), ActorNetwork(actor)
        self._critics = Critics(len(actor.middle), settings.hidden)
        self._slow_actor, self._slow_critics = copy.deepcopy(self._actor), copy.deepcopy(self._critics)
        self._actor_steps = torch.optim.Adam(self._actor.parameters(), lr=settings.actor_rate, fused=True)
        self._critic_steps = torch.optim.Adam(self._critics.parameters(), lr=settings.critic_rate, fused=True)
        self._count = 0

    def act(self, observation: Vector) -> Vector:
        """Return the action (2,) for an observation (n,) in SI units."""
        with torch.no_grad():
            action = self._actor(torch.from_numpy(self._scaled(observation)))
        return np.asarray(action.numpy().clip(-1.0, 1.0), dtype=np.float32)

    def add(
        self, seen: Vector, action: Vector, reward: float, following: Vector, discount: float, by_operator: bool
    ) -> None:
        """Remember a step; observations are in SI units."""
        self.replay.add(self._scaled(seen), action, reward, self._scaled(following), discount, float(by_operator))

    def learn(self, steps: int, random: np.random.Generator) -> None:
        """Learn after so many new steps."""
        settings = self.settings
        if len(self.replay) < settings.first_steps:
            return
        if self._count == 0:
            for _ in range(settings.first_updates):
                self._update(random, improve=False)
        for _ in range(steps * settings.updates):
            self._update(random, improve=True)

    def to_actor(self, manifest: Mapping[str, Any]) -> Actor:
        """Return the policy, averaged over its last updates, with more in its manifest."""
        return self._slow_actor.to_actor(manifest)

    def arrays(self) -> dict[str, Any]:
        """Return all that learning goes on from."""
        return {
            **state_arrays(self._networks(), self._optimizers()),
            **self.replay.arrays(),
            "count": np.array([self._count]),
        }

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Go on from a checkpoint.

        Raises:
            KeyError, RuntimeError, ValueError: It is of another policy.
        """
        restore_state(self._networks(), self._optimizers(), arrays)
        self.replay.restore(arrays)
        self._count = int(arrays["count"][0])

    def _update(self, random: np.random.Generator, improve: bool) -> None:
        self._count += 1
        batch = self.replay.batch(self.settings.batch, random)
        with torch.no_grad():
            noise = (_NOISE * torch.randn_like(batch.actions)).clamp(-_NOISE_LIMIT, _NOISE_LIMIT)
            actions = (self._slow_actor(batch.following) + noise).clamp(-1.0, 1.0)
            target = batch.rewards + batch.discounts * self._slow_critics.least(batch.following, actions)
        first, second = self._critics(batch.seen, batch.actions)
        _step(self._critic_steps, mse_loss(first, target) + mse_loss(second, target))
        if self._count % _DELAY == 0:
            if improve:
                self._improve(batch)
            track(self._slow_critics, self._critics, _TAU)

    def _improve(self, batch: Any) -> None:
        actions = self._actor(batch.seen)
        worth, _ = self._critics(batch.seen, actions)
        with torch.no_grad():
            wanted = torch.where(batch.operator[:, None] > 0.0, batch.actions, self._first(batch.seen))
            weight = torch.where(batch.operator > 0.0, self.settings.hold, self._hold())
        gain = worth.mean() / worth.detach().abs().mean().clamp(min=1e-6)
        away = ((actions - wanted) ** 2).mean(dim=-1)
        _step(self._actor_steps, (weight * away).mean() - gain)
        track(self._slow_actor, self._actor, _TAU)

    def _hold(self) -> float:
        settings = self.settings
        left = max(0.0, 1.0 - (len(self.replay) - settings.first_steps) / settings.fading)
        return settings.hold_at_last + (settings.hold - settings.hold_at_last) * left

    def _scaled(self, observation: Vector) -> Vector:
        return ((observation - self._middle) / self._unit).astype(np.float32)

    def _networks(self) -> dict[str, torch.nn.Module]:
        return {
            "actor": self._actor,
            "critics": self._critics,
            "slow_actor": self._slow_actor,
            "slow_critics": self._slow_critics,
        }

    def _optimizers(self) -> dict[str, torch.optim.Optimizer]:
        return {"actor_steps": self._actor_steps, "critic_steps": self._critic_steps}


def _step(optimizer: torch.optim.Optimizer, loss: torch.Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()

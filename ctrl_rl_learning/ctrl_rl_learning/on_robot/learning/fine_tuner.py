"""Sample-efficient fine-tuning: TD3 with several updates per step that stays close to the initial policy.

The first steps train the critics alone. Then the actor maximises the critics' value under two penalties: one for
deviating from the initial policy, with a decaying weight, and one for deviating from the operator's take-over commands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ctrl_rl_core import Actor
from ctrl_rl_learning.torch.checkpoints import restore_state, state_arrays
from ctrl_rl_learning.torch.networks import ActorNetwork, Critics
from ctrl_rl_learning.torch.optimization import gradient_step
from ctrl_rl_learning.torch.replay_buffer import ReplayBuffer
from ctrl_rl_learning.torch.td3 import Td3

Vector = NDArray[np.float32]
_REPLAY = "replay."


@dataclass(frozen=True)
class TuneSettings:
    """Settings of fine-tuning.

    Attributes:
        updates: Number of critic updates per robot step.
        first_updates: Number of critic updates before the actor starts to learn.
        first_steps: Number of steps before the first critic update.
        noise: Standard deviation of the exploration noise, in actions.
        discount: Discount of a step of nominal length.
        batch: Batch size, in steps.
        hidden: Units of each hidden layer of the critics.
        actor_rate: Learning rate of the actor.
        critic_rate: Learning rate of the critics.
        hold: Weight of the penalty for deviating from the initial policy, when the actor starts to learn.
        hold_at_last: The same weight after `fading` steps.
        fading: Number of steps over which the weight decays.
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
    """Learner that improves a policy from a replay buffer of robot steps.

    Attributes:
        settings: Settings of fine-tuning.
        replay: Every step of the robot with the action as driven, the operator's steps included.
    """

    def __init__(self, actor: Actor, settings: TuneSettings, capacity: int, seed: int) -> None:
        """Create the learner.

        Args:
            actor: Initial policy.
            settings: Settings of fine-tuning.
            capacity: Maximum number of stored steps.
            seed: Seed of networks and batches.
        """
        torch.manual_seed(seed)
        self.settings, self.replay = settings, ReplayBuffer(capacity)
        self._middle, self._unit = actor.middle, actor.unit
        self._actor, self._first = ActorNetwork(actor), ActorNetwork(actor)
        self._critics = Critics(len(actor.middle), settings.hidden)
        self._actor_steps = torch.optim.Adam(self._actor.parameters(), lr=settings.actor_rate, fused=True)
        self._critic_steps = torch.optim.Adam(self._critics.parameters(), lr=settings.critic_rate, fused=True)
        self._td3 = Td3(self._actor, self._critics, self._critic_steps)

    def act(self, observation: Vector) -> Vector:
        """Return the action (2,) for an observation (n,) in SI units."""
        with torch.no_grad():
            action = self._actor(torch.from_numpy(self._scaled(observation)))
        return np.asarray(action.numpy().clip(-1.0, 1.0), dtype=np.float32)

    def add(
        self,
        observation: Vector,
        action: Vector,
        reward: float,
        next_observation: Vector,
        discount: float,
        by_operator: bool,
    ) -> None:
        """Add a step to the replay buffer; observations are in SI units.

        Args:
            observation: Observation before the step (n,).
            action: Action as driven (2,).
            reward: Reward of the step.
            next_observation: Observation after the step (n,).
            discount: Discount of the next value: smaller after a longer step, 0 at the end of an episode.
            by_operator: Whether the operator drove during part of the step.
        """
        row = {
            "seen": self._scaled(observation),
            "actions": action,
            "rewards": reward,
            "following": self._scaled(next_observation),
            "discounts": discount,
            "operator": by_operator,
        }
        self.replay.add({name: np.asarray(value, np.float32)[None] for name, value in row.items()})

    def learn(self, steps: int, random: np.random.Generator) -> dict[str, float]:
        """Update for a number of new steps, and return the mean losses; empty if there was no update."""
        settings = self.settings
        if len(self.replay) < settings.first_steps:
            return {}
        losses: dict[str, list[float]] = {}
        alone = settings.first_updates if self._td3.updates == 0 else 0
        for number in range(alone + steps * settings.updates):
            for name, loss in self._update(random, improve=number >= alone).items():
                losses.setdefault(name, []).append(loss)
        return {name: float(np.mean(each)) for name, each in losses.items()}

    def to_actor(self, manifest: Mapping[str, Any]) -> Actor:
        """Return the policy, averaged over its last updates, with entries added to its manifest."""
        return self._td3.target_actor.to_actor(manifest)

    def arrays(self) -> dict[str, Any]:
        """Return the learner's state, for a checkpoint."""
        return {
            **state_arrays(self._networks(), self._optimizers()),
            **{f"{_REPLAY}{name}": column for name, column in self.replay.in_order().items()},
            "count": np.array([self._td3.updates]),
        }

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state from a checkpoint.

        Raises:
            KeyError, RuntimeError, ValueError: The checkpoint belongs to another policy.
        """
        restore_state(self._networks(), self._optimizers(), arrays)
        rows = {name.removeprefix(_REPLAY): rows for name, rows in arrays.items() if name.startswith(_REPLAY)}
        if rows and len(rows["seen"]):
            self.replay.add({name: column[-self.replay.capacity :] for name, column in rows.items()})
        self._td3.updates = int(arrays["count"][0])

    def _update(self, random: np.random.Generator, improve: bool) -> dict[str, float]:
        rows = self.replay.draw(self.settings.batch, random)
        batch = {name: torch.from_numpy(column) for name, column in rows.items()}
        targets = self._td3.targets(batch["rewards"], batch["discounts"], batch["following"], batch["actions"])
        first, second = self._critics(batch["seen"], batch["actions"])
        losses = {"critic_loss": float(self._td3.learn(first, second, targets))}
        if self._td3.actors_turn:
            if improve:
                losses["actor_loss"] = self._improve(batch)
            self._td3.follow(actor=improve)
        return losses

    def _improve(self, batch: Mapping[str, torch.Tensor]) -> float:
        actions, operator = self._actor(batch["seen"]), batch["operator"]
        q_values, _ = self._critics(batch["seen"], actions)
        with torch.no_grad():
            wanted = torch.where(operator[:, None] > 0.0, batch["actions"], self._first(batch["seen"]))
            weight = torch.where(operator > 0.0, self.settings.hold, self._hold())
        gain = q_values.mean() / q_values.detach().abs().mean().clamp(min=1e-6)
        away = ((actions - wanted) ** 2).mean(dim=-1)
        loss = (weight * away).mean() - gain
        gradient_step(self._actor_steps, loss)
        return float(loss.detach())

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
            "slow_actor": self._td3.target_actor,
            "slow_critics": self._td3.target_critics,
        }

    def _optimizers(self) -> dict[str, torch.optim.Optimizer]:
        return {"actor_steps": self._actor_steps, "critic_steps": self._critic_steps}

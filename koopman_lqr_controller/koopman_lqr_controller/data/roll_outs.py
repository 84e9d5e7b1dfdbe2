"""Episodes of a policy in any environment: returns, and the data that a model is fitted to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from koopman_lqr_controller.arrays import Array


class Environment(Protocol):
    """Environment in Gymnasium's form, with actions in [-1, 1]."""

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode and return an observation."""

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Hold an action; return observation, reward, whether it terminated or was truncated, and more."""


class Policy(Protocol):
    """Policy from x over features and latent state to u and the action that stands for it."""

    @property
    def encoder(self) -> Callable[[Any], Array]:
        """Returns the features psi(x)."""

    def project(self, z: Array, /) -> Array:
        """Return the latent state of features."""

    def control(self, z: Array, /) -> Array:
        """Return u."""

    def saturate(self, u: Array, /) -> Array:
        """Return the action in [-1, 1]."""


@dataclass(frozen=True)
class Episode:
    """One episode.

    Attributes:
        features: psi(x) of each observation, before any projection (T + 1, n).
        actions: Actions that were done (T, m).
        total: Undiscounted return of the episode.
        steps: Number of actions, T.
        saturated: Share of these that the law wanted beyond -1 or 1, over all controls.
        info: The environment's last word.
        noise: Standard deviation of what was added to u.
    """

    features: Array
    actions: Array
    total: float
    steps: int
    saturated: float
    info: dict[str, Any]
    noise: float = 0.0


def projected(project: Callable[[Array], Array], episodes: Sequence[Episode]) -> tuple[list[Array], list[Array]]:
    """Return the latent states (T + 1, n) and the actions (T, m) of each episode: what models are held against."""
    return [project(episode.features) for episode in episodes], [episode.actions for episode in episodes]


def roll_out(
    controller: Policy,
    environment: Environment,
    seed: int,
    noise: float = 0.0,
    keep: bool = False,
) -> Episode:
    """Return one episode.

    Args:
        controller: Policy that acts.
        environment: Environment to act in.
        seed: Seed of the episode and of the noise.
        noise: Standard deviation of what is added to u before saturation: it excites the model.
        keep: Whether features and actions are wanted; else they are empty.
    """
    random = np.random.default_rng(seed)
    x, info = environment.reset(seed=seed)
    features, actions, total, beyond, steps, over = [], [], 0.0, 0.0, 0, False
    while not over:
        psi = controller.encoder(x)
        u = controller.control(controller.project(psi))
        action = controller.saturate(u + noise * random.standard_normal(u.shape) if noise else u)
        x, reward, terminated, truncated, info = environment.step(action)
        total, steps, beyond = total + float(reward), steps + 1, beyond + float(np.mean(np.abs(u) > 1.0))
        over = terminated or truncated
        if keep:
            features.append(psi)
            actions.append(action)
    if keep:
        features.append(controller.encoder(x))
    return Episode(np.array(features), np.array(actions), total, steps, beyond / max(1, steps), info, noise)


def evaluate(
    controller: Policy, environment: Environment, episodes: int, seed: int, keep: bool = False
) -> list[Episode]:
    """Return the episodes `seed`, `seed` + 1 and so on; features and actions only where they are to `keep`."""
    return [roll_out(controller, environment, seed + episode, keep=keep) for episode in range(episodes)]


def mean_return(episodes: Sequence[Episode]) -> float:
    """Return the mean undiscounted return."""
    return float(np.mean([episode.total for episode in episodes]))


def saturated(episodes: Sequence[Episode]) -> float:
    """Return the share of all steps that the law wanted beyond -1 or 1."""
    return float(np.average([each.saturated for each in episodes], weights=[max(1, each.steps) for each in episodes]))


def count_interaction(episodes: Sequence[Episode]) -> dict[str, int]:
    """Return how many episodes and actions these are."""
    return {"episodes": len(episodes), "actions": sum(episode.steps for episode in episodes)}


def outcomes(episodes: Sequence[Episode]) -> dict[str, int]:
    """Return how many episodes ended which way; nothing where the environment does not say."""
    ended = [str(episode.info["outcome"]) for episode in episodes if "outcome" in episode.info]
    return {outcome: ended.count(outcome) for outcome in sorted(set(ended))}


def noisy_roll_outs(controller: Policy, environment: Environment, noises: Sequence[float], seed: int) -> list[Episode]:
    """Return one episode for each noise."""
    return [roll_out(controller, environment, seed + index, noise, keep=True) for index, noise in enumerate(noises)]

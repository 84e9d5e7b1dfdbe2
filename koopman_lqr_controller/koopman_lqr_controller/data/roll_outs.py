"""Episodes of a policy in any environment: returns, and the data that a model is fitted to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ctrl_rl_core import DrivenRobot, drive
from koopman_lqr_controller.arrays import Array


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
    environment: DrivenRobot[Any],
    seed: int,
    noise: float = 0.0,
    keep: bool = False,
) -> Episode:
    """Return one episode.

    Args:
        controller: Policy that acts.
        environment: DrivenRobot[Any] to act in.
        seed: Seed of the episode and of the noise.
        noise: Standard deviation of what is added to u before saturation: it excites the model.
        keep: Whether features and actions are wanted; else they are empty.
    """
    driver = _LatentDriver(controller, noise, np.random.default_rng(seed))
    (episode,) = drive(environment, driver, seeds=(seed,), keep=keep)
    features = [controller.encoder(step.sensors) for step in episode.trace[-1:]]
    actions = [step.command for step in episode.trace[1:]]
    return Episode(
        np.array((driver.features if keep else []) + features),
        np.array(actions),
        episode.total,
        episode.steps,
        driver.beyond / max(1, episode.steps),
        dict(episode.info),
        noise,
    )


class _LatentDriver:
    """A policy as a driver, with noise before saturation, and notes of what it sees and wants."""

    def __init__(self, policy: Policy, noise: float, random: np.random.Generator) -> None:
        self._policy, self._noise, self._random = policy, noise, random
        self.features: list[Array] = []
        self.beyond = 0.0

    def command(self, x: Any) -> Array:
        psi = self._policy.encoder(x)
        self.features.append(psi)
        u = self._policy.control(self._policy.project(psi))
        self.beyond += float(np.mean(np.abs(u) > 1.0))
        noise = self._noise * self._random.standard_normal(u.shape) if self._noise else 0.0
        return self._policy.saturate(u + noise)


def evaluate(
    controller: Policy, environment: DrivenRobot[Any], episodes: int, seed: int, keep: bool = False
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


def noisy_roll_outs(
    controller: Policy, environment: DrivenRobot[Any], noises: Sequence[float], seed: int
) -> list[Episode]:
    """Return one episode for each noise."""
    return [roll_out(controller, environment, seed + index, noise, keep=True) for index, noise in enumerate(noises)]

"""Episodes of a policy in any environment: returns, and data for fitting models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ctrl_rl_core import DrivenRobot, drive
from koopman_lqr_controller.arrays import Array


class Policy(Protocol):
    """A policy that maps x to features, a latent state, u and the action."""

    @property
    def encoder(self) -> Callable[[Any], Array]:
        """Return the features psi(x)."""

    def project(self, z: Array, /) -> Array:
        """Return the latent state of features."""

    def control(self, z: Array, /) -> Array:
        """Return u."""

    def saturate(self, u: Array, /) -> Array:
        """Map u to the action in [-1, 1]."""


@dataclass(frozen=True)
class Episode:
    """One episode.

    Attributes:
        features: psi(x) of each observation, before any projection (T + 1, n).
        actions: Executed actions (T, m).
        total: Undiscounted return of the episode.
        steps: Number of actions, T.
        saturated: Fraction of the law's outputs beyond -1 or 1, over all controls.
        info: Info of the last step.
        noise: Standard deviation of the noise added to u.
    """

    features: Array
    actions: Array
    total: float
    steps: int
    saturated: float
    info: dict[str, Any]
    noise: float = 0.0


def projected(project: Callable[[Array], Array], episodes: Sequence[Episode]) -> tuple[list[Array], list[Array]]:
    """Return latent states (T + 1, n) and actions (T, m) of each episode, for evaluating models."""
    return [project(episode.features) for episode in episodes], [episode.actions for episode in episodes]


def roll_out(
    controller: Policy,
    environment: DrivenRobot[Any],
    seed: int,
    noise: float = 0.0,
    keep: bool = False,
) -> Episode:
    """Run one episode and return it.

    Args:
        controller: Policy that acts.
        environment: Environment to act in.
        seed: Seed of the episode and of the noise.
        noise: Standard deviation of the noise added to u before saturation, to excite the model.
        keep: Whether to keep features and actions; otherwise they are empty.
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
    """A policy as a driver, with noise before saturation, that records its features and outputs."""

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
    """Run the episodes `seed`, `seed` + 1, etc.; features and actions are stored only if `keep`."""
    return [roll_out(controller, environment, seed + episode, keep=keep) for episode in range(episodes)]


def mean_return(episodes: Sequence[Episode]) -> float:
    """Return the mean undiscounted return."""
    return float(np.mean([episode.total for episode in episodes]))


def saturated(episodes: Sequence[Episode]) -> float:
    """Return the fraction of the law's outputs beyond -1 or 1, over all steps."""
    return float(np.average([each.saturated for each in episodes], weights=[max(1, each.steps) for each in episodes]))


def count_interaction(episodes: Sequence[Episode]) -> dict[str, int]:
    """Return the numbers of episodes and actions."""
    return {"episodes": len(episodes), "actions": sum(episode.steps for episode in episodes)}


def outcomes(episodes: Sequence[Episode]) -> dict[str, int]:
    """Count the episodes by outcome; empty if the environment reports none."""
    ended = [str(episode.info["outcome"]) for episode in episodes if "outcome" in episode.info]
    return {outcome: ended.count(outcome) for outcome in sorted(set(ended))}


def noisy_roll_outs(
    controller: Policy, environment: DrivenRobot[Any], noises: Sequence[float], seed: int
) -> list[Episode]:
    """Run one episode per noise level."""
    return [roll_out(controller, environment, seed + index, noise, keep=True) for index, noise in enumerate(noises)]

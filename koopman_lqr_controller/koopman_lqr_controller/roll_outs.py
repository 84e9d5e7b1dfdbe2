"""Episodes of a latent controller in any environment: their returns, and what the model is fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.latent_controller import LatentController

Array = NDArray[np.float64]


class Environment(Protocol):
    """What is needed of an environment: Gymnasium's form, actions in [-1, 1]."""

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode and return an observation."""

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Hold an action; return observation, reward, whether it terminated or was truncated, and more."""


@dataclass(frozen=True)
class Lived:
    """One episode.

    Attributes:
        features: psi(x) of each observation, before any projection (T + 1, n).
        actions: what was done (T, m).
        total: undiscounted return.
        steps: how many actions were done, T.
        saturated: share of these that the law wanted beyond -1 or 1, over all controls.
        info: the environment's last word.
    """

    features: Array
    actions: Array
    total: float
    steps: int
    saturated: float
    info: dict[str, Any]


def roll_out(
    controller: LatentController,
    environment: Environment,
    seed: int,
    noise: float = 0.0,
    keep: bool = False,
) -> Lived:
    """Return one episode.

    Args:
        controller: what acts.
        environment: where.
        seed: of the episode and of the noise.
        noise: standard deviation of what is added to u before saturation: it excites the model.
        keep: whether features and actions are wanted; else they are empty.
    """
    random = np.random.default_rng(seed)
    x, info = environment.reset(seed=seed)
    features, actions, total, beyond, steps, over = [], [], 0.0, 0.0, 0, False
    while not over:
        psi = controller.encoder(x)
        u = controller.control(controller.project(psi))
        action = controller.saturate(u + noise * random.standard_normal(u.shape) if noise else u)
        x, paid, terminated, truncated, info = environment.step(action)
        total, steps, beyond = total + float(paid), steps + 1, beyond + float(np.mean(np.abs(u) > 1.0))
        over = terminated or truncated
        if keep:
            features.append(psi)
            actions.append(action)
    if keep:
        features.append(controller.encoder(x))
    return Lived(np.array(features), np.array(actions), total, steps, beyond / max(1, steps), info)


def evaluate(controller: LatentController, environment: Environment, episodes: int, seed: int) -> list[Lived]:
    """Return the episodes `seed`, `seed` + 1 and so on, without their features."""
    return [roll_out(controller, environment, seed + episode) for episode in range(episodes)]


def mean_return(lived: Sequence[Lived]) -> float:
    """Return the mean undiscounted return."""
    return float(np.mean([episode.total for episode in lived]))


def saturated(lived: Sequence[Lived]) -> float:
    """Return the share of all steps that the law wanted beyond -1 or 1."""
    return float(np.average([each.saturated for each in lived], weights=[max(1, each.steps) for each in lived]))


def interaction(lived: Sequence[Lived]) -> dict[str, int]:
    """Return how many episodes and actions these are."""
    return {"episodes": len(lived), "actions": sum(episode.steps for episode in lived)}


def outcomes(lived: Sequence[Lived]) -> dict[str, int]:
    """Return how many episodes ended which way; nothing where the environment does not say."""
    ended = [str(episode.info["outcome"]) for episode in lived if "outcome" in episode.info]
    return {outcome: ended.count(outcome) for outcome in sorted(set(ended))}


def noisy_roll_outs(
    controller: LatentController, environment: Environment, noises: Sequence[float], seed: int
) -> list[Lived]:
    """Return one episode for each noise."""
    return [roll_out(controller, environment, seed + index, noise, keep=True) for index, noise in enumerate(noises)]

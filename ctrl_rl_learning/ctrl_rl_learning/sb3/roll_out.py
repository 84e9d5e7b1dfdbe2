"""Episodes of a deployed policy in a simulated task; needs no torch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.tasks.outcome import Outcome
from numpy.typing import NDArray

from ctrl_rl_core import Actor
from ctrl_rl_learning.sb3.environment import Environment, Vector

SUCCESS = Outcome.GOAL.name


class EvaluatedEpisode(NamedTuple):
    """An episode of a deterministic policy.

    Attributes:
        outcome: Name of its outcome.
        states: States that it went through (steps + 1, n).
        total: Undiscounted return of the episode.
    """

    outcome: str
    states: NDArray[np.float64]
    total: float


def evaluate(actor: Actor, environment: Environment, episodes: int, seed: int) -> list[EvaluatedEpisode]:
    """Return episodes from the seeds `seed`, `seed` + 1 and so on."""
    seeds = range(seed, seed + episodes)
    return [play_episode(environment, each, lambda seen, _: actor.scaled_action(seen)) for each in seeds]


def play_episode(environment: Environment, seed: int, act: Callable[[Vector, Any], Vector]) -> EvaluatedEpisode:
    """Return the episode of a seed; `act` returns the action for an observation and the true state."""
    observation, info = environment.reset(seed=seed)
    states, total, over = [info["state"]], 0.0, False
    while not over:
        observation, paid, terminated, truncated, info = environment.step(act(observation, info["state"]))
        states.append(info["state"])
        total += float(paid)
        over = terminated or truncated
    return EvaluatedEpisode(info["outcome"], np.array(states), total)

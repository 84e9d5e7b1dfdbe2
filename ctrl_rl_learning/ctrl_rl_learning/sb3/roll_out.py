"""Episodes of a deployed policy in a simulated task; needs no torch."""

from __future__ import annotations

from ctrl_rl_core import Actor, Episodes, FunctionDriver, Outcome, drive
from ctrl_rl_learning.sb3.environment import Environment, Vector

SUCCESS = Outcome.GOAL.name


def evaluate(actor: Actor, environment: Environment, episodes: int, seed: int) -> Episodes[Vector]:
    """Return episodes from the seeds `seed`, `seed` + 1 and so on, with their states."""
    return drive(environment, FunctionDriver(actor.scaled_action), seeds=range(seed, seed + episodes), keep=True)

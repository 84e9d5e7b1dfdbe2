"""Robots that vanish for a while: a team that is to go on without one of them must have learnt with that."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_PART = 4


class RobotDropout(NamedTuple):
    """A robot is absent for a while.

    Attributes:
        agent: its index.
        begin: low-level step after which it is gone.
        end: and after which it is there again, without an option.
    """

    agent: int
    begin: int
    end: int


def draw_dropout(chance: float, agents: int, step_limit: int, generator: np.random.Generator) -> RobotDropout | None:
    """Return an episode's outage, or that there is none.

    Args:
        chance: that there is one.
        agents: how many; each is as likely to vanish.
        step_limit: of the episode; it begins in the first quarter of that and lasts for another at most.
        generator: of the draw; untouched where there is no chance.
    """
    if chance == 0.0 or generator.random() >= chance:
        return None
    longest = max(1, step_limit // _PART)
    begin = 1 + int(generator.integers(longest))
    return RobotDropout(int(generator.integers(agents)), begin, begin + 1 + int(generator.integers(longest)))

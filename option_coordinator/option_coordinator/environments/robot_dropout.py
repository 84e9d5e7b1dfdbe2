"""Random drop-out of a robot during an episode, so that a team learns to go on without it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_PART = 4


class RobotDropout(NamedTuple):
    """A period in which a robot is absent.

    Attributes:
        agent: Index of the robot.
        begin: Low-level step after which the robot is absent.
        end: Low-level step after which it is present again, without an option.
    """

    agent: int
    begin: int
    end: int


def draw_dropout(chance: float, agents: int, step_limit: int, generator: np.random.Generator) -> RobotDropout | None:
    """Return the drop-out of an episode, None for none.

    Args:
        chance: Probability of a drop-out, 0 to 1.
        agents: Number of robots; each is as likely to drop out.
        step_limit: Step limit of the episode; a drop-out begins in its first quarter and lasts a quarter at most.
        generator: Random generator; unused if the probability is 0.
    """
    if chance == 0.0 or generator.random() >= chance:
        return None
    longest = max(1, step_limit // _PART)
    begin = 1 + int(generator.integers(longest))
    return RobotDropout(int(generator.integers(agents)), begin, begin + 1 + int(generator.integers(longest)))

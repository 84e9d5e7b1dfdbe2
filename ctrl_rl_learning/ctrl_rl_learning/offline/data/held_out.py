"""Which episodes to learn from, and which to judge by."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.transitions import Transitions

FEWEST = 10
"""Episodes to learn from, and to judge by, at least."""
ENOUGH = 20
"""Held-out episodes that judge alone: a success of all of them leaves at most 16 failures of 100 open."""


def hold_out(transitions: Transitions, share: float, seed: int) -> tuple[Transitions, Transitions]:
    """Return the episodes to learn from and those to judge by, drawn by a seed.

    Args:
        transitions: Transitions of all episodes.
        share: Share of the episodes to judge by; at least `FEWEST` are.
        seed: Seed of the draw.

    Raises:
        LearningError: There are too few episodes for both.
    """
    count = transitions.episode_count
    held = max(FEWEST, round(share * count))
    if count - held < FEWEST:
        needed = max(2 * FEWEST, round(FEWEST / (1.0 - share)))
        raise LearningError(
            f"{count} episodes are too few to learn from {FEWEST} and judge by {FEWEST} others: record "
            f"{max(needed - count, 1)} more, with the same driver"
        )
    drawn = np.zeros(count, dtype=np.bool_)
    drawn[np.random.default_rng(seed).permutation(count)[:held]] = True
    starts = np.append(np.flatnonzero(transitions.first), len(transitions))
    of_rows = np.repeat(drawn, [high - low for low, high in pairwise(starts)])
    return transitions.rows(~of_rows), transitions.rows(of_rows)

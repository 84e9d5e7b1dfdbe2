"""Random streams, one per robot and purpose, so that none depends on the use of another."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """Purpose of a stream."""

    START = 0
    WIDTH = 1
    SCAN = 2
    ODOMETRY = 3
    LOCALISATION = 4
    CONDITIONS = 5
    MOVERS = 6
    DOORWAYS = 7


def stream(seed: int, purpose: Purpose, robot: int = 0) -> np.random.Generator:
    """Return a random stream of an episode's seed."""
    return np.random.default_rng((seed, robot, purpose))

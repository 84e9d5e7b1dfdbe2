"""Where the moving obstacles of a recorded drive were."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.ros.node import seconds
from numpy.typing import NDArray

from ctrl_rl_bags import read_messages

MOVERS = "/movers"


@dataclass(frozen=True)
class MoverTrack:
    """One moving obstacle.

    Attributes:
        radius: Radius of the cylinder [m].
        track: Time since the start, x, y (n, 3) [s, m, m].
    """

    radius: float
    track: NDArray[np.float64]

    def at(self, time: float) -> tuple[float, float]:
        """Return its position at a time since the start [m]."""
        x, y = (np.interp(time, self.track[:, 0], self.track[:, column]) for column in (1, 2))
        return float(x), float(y)


def read_movers(bag: Path, begin: float) -> tuple[MoverTrack, ...]:
    """Return the movers of a bag of a ground robot, in the order of the task file.

    Args:
        bag: Folder of the bag.
        begin: Stamp of the start [s].
    """
    radii: dict[int, float] = {}
    rows: dict[int, list[tuple[float, float, float]]] = defaultdict(list)
    for message in read_messages(bag, [MOVERS]):
        data: Any = message.data
        time = seconds(data.header.stamp) - begin
        for mover in data.movers:
            radii[mover.id] = mover.radius
            rows[mover.id].append((time, mover.position.x, mover.position.y))
    return tuple(MoverTrack(radii[number], np.array(rows[number])) for number in sorted(rows))

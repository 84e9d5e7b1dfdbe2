"""What a certificate needs to know: echoes, motion, the robot's body, a recoverable set, and bounds of its delay."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_safety.models.growth import Growth
from ctrl_rl_safety.models.motion import Motion
from ctrl_rl_safety.sets.distance_field import Obstacles


class Guide(NamedTuple):
    """The recoverable set in the form used by compiled code.

    Attributes:
        values: Values of the set; a single node without a set.
        x: Position of its first column [m].
        y: Position of its first row [m].
        cell: Node spacing [m].
        top: Speed of its last level [m/s].
        ready: Whether a set is available.
    """

    values: NDArray[np.float32]
    x: float
    y: float
    cell: float
    top: float
    ready: bool


NO_GUIDE = Guide(np.zeros((1, 1, 1, 1), np.float32), 0.0, 0.0, 1.0, 1.0, False)


class Sooner(NamedTuple):
    """Where the robot is when a command has its first effect, if its delay is the shortest that it may have.

    Attributes:
        differs: Whether the delay has bounds that differ.
        state: The state.
        t: Age of the echoes at that time [s].
    """

    differs: bool
    state: tuple[float, float, float, float, float]
    t: float


ONE_DELAY = Sooner(False, (0.0, 0.0, 0.0, 0.0, 0.0), 0.0)
"""For a robot whose delay is known."""


class Situation(NamedTuple):
    """All inputs of a certificate.

    Attributes:
        obstacles: Echoes in the odometry frame.
        growth: Bounds of motion.
        motion: Motion model of the robot for one time step.
        guide: Recoverable set, if any.
        core: Half the length and width of the robot's rectangle [m]; zeros for a disc.
        rooms: Required distance of the core to static and to moving echoes [m].
        close: Whether the robot starts with less clearance than required; it may then only turn or move to more open
            space.
        hold: Number of time steps until the following command takes effect.
        turn_rate: Maximum turn rate [rad/s].
        lag: Time constant of the speeds [s].
        sooner: Where a command may have its first effect as well.
    """

    obstacles: Obstacles
    growth: Growth
    motion: Motion
    guide: Guide
    core: tuple[float, float]
    rooms: tuple[float, float]
    close: bool
    hold: int
    turn_rate: float
    lag: float
    sooner: Sooner = ONE_DELAY

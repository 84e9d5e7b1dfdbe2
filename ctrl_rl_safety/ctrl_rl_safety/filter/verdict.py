"""Settings and answers of the safety filter."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Mode(IntEnum):
    """What the filter did with a command."""

    PASSED = 1
    CORRECTED = 2
    ESCAPING = 3
    UNBLOCKING = 4
    EVADING = 5


@dataclass(frozen=True)
class FilterOptions:
    """Settings of a filter.

    Attributes:
        period: Longest time from one command to the next [s].
        mover_speed: Largest speed of other movers [m/s]; 0 for a static world.
        mover_acceleration: Largest acceleration of what is known to stand [m/s^2].
        standing_time: Time for which an echo must have been there to be known to stand [s].
        mover_size: Largest extent of a mover [m]: a surface that stands and is longer is a wall, which never moves;
            0 where none is to count as one.
        hysteresis: Margin that lets a command pass again after a correction [m].
        unblock_after: Time for which the filter holds the robot before it turns it to a free side [s]; 0 for never.
        evade: Whether a robot that would stand goes out of the way of a mover that comes near.
        occluded_movers: Whether movers may step out from behind an edge that the scan shows.
        unseen: Kind of the space that never was seen, behind the robot or an edge; such an obstacle stays.
    """

    period: float = 0.075
    mover_speed: float = 0.0
    mover_acceleration: float = 1.0
    standing_time: float = 1.0
    mover_size: float = 1.0
    hysteresis: float = 0.02
    unblock_after: float = 3.0
    evade: bool = False
    occluded_movers: bool = False
    unseen: Literal["free", "obstacle"] = "free"


@dataclass(frozen=True)
class Reading:
    """The robot by odometry.

    Attributes:
        pose: Pose x, y, theta in the frame of the odometry (3,) [m, m, rad].
        v: Speed by odometry [m/s].
        omega: Turn rate [rad/s].
        age: Age of the odometry [s].
    """

    pose: Array
    v: float
    omega: float
    age: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """The answer to one command.

    Attributes:
        command: Speed [m/s] and turn rate [rad/s] to send (2,).
        mode: Kind of the answer to the command.
        margin: Margin of the certificate [m]; exact where it is less than 0.04.
        value: Margin of the present state by the recoverable set [m]; NaN without one.
        state: State when the command has an effect (5,).
        escape: Kind of its escape.
    """

    command: Array
    mode: Mode
    margin: float
    value: float = math.nan
    state: Array = field(default_factory=lambda: np.zeros(5))
    escape: int = 0

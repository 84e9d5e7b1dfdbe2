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
    """Action of the filter on a command."""

    PASSED = 1
    CORRECTED = 2
    ESCAPING = 3
    UNBLOCKING = 4
    EVADING = 5


@dataclass(frozen=True)
class FilterOptions:
    """Settings of a filter.

    Attributes:
        period: Maximum interval between commands [s].
        mover_speed: Maximum speed of movers [m/s]; 0 for a static world.
        mover_acceleration: Maximum acceleration of obstacles seen as static [m/s^2].
        standing_time: Time for which an echo must persist to count as static [s].
        mover_size: Maximum extent of a mover [m]: a longer static surface counts as a wall, which never moves; 0 to
            disable walls.
        hysteresis: Margin required for a command to pass again after a correction [m].
        unblock_after: Blocked time after which the filter turns the robot to a free side [s]; 0 for never.
        evade: Whether a stationary robot moves out of the way of an approaching mover.
        occluded_movers: Whether movers may emerge from behind an edge in the scan.
        unseen: Treatment of unseen space, behind the robot or an edge; as an obstacle, it is static.
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
    """Odometry reading of the robot.

    Attributes:
        pose: Pose x, y, theta in the odometry frame (3,) [m, m, rad].
        v: Speed [m/s].
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
        mode: Action of the filter.
        margin: Margin of the certificate [m]; exact below 0.04.
        value: Margin of the present state according to the recoverable set [m]; NaN without a set.
        state: State when the command takes effect (5,).
        escape: Kind of the escape.
    """

    command: Array
    mode: Mode
    margin: float
    value: float = math.nan
    state: Array = field(default_factory=lambda: np.zeros(5))
    escape: int = 0

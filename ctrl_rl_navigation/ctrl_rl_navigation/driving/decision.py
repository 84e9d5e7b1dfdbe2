"""Goals, settings and answers of the navigator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class NavigatorState(IntEnum):
    """State of the navigator; the numbers are those of ctrl_rl_msgs/NavigatorStatus."""

    WAITING = 0
    SOLVING = 1
    DRIVING = 2
    REACHED = 3
    UNREACHABLE = 4
    BLOCKED = 5
    CANCELLED = 6


@dataclass(frozen=True)
class Goal:
    """A place to drive to.

    Attributes:
        position: Position in the map's frame (2,) [m].
        heading: Direction to turn into on arrival [rad]; None for any.
    """

    position: tuple[float, float]
    heading: float | None = None


@dataclass(frozen=True)
class NavigatorOptions:
    """Settings of a navigator.

    Attributes:
        tolerance: Distance from the goal at which it counts as reached [m].
        heading_tolerance: Error of the heading on arrival [rad].
        memory: Time after which an obstacle that nothing sees is forgotten [s].
        period: Time from command to command [s].
        delay: Time from a command to its effect and until the next one [s].
        deceleration: Deceleration of the robot when it brakes [m/s^2].
        inline: Whether values are solved at once instead of in a thread.
    """

    tolerance: float = 0.15
    heading_tolerance: float = 0.2
    memory: float = 10.0
    period: float = 0.1
    delay: float = 0.2
    deceleration: float = 0.5
    inline: bool = False


@dataclass(frozen=True)
class Decision:
    """The answer of one control period.

    Attributes:
        command: Speed [m/s] and turn rate [rad/s] (2,).
        state: State of the navigator.
        message: Reason of the state, in words.
        remaining_time: Time to reach the goal [s]; NaN where it is unknown.
    """

    command: Array
    state: NavigatorState
    message: str
    remaining_time: float = math.nan

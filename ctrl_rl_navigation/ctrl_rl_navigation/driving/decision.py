"""Goals, settings and decisions of the navigator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class NavigatorState(IntEnum):
    """State of the navigator, with the values of ctrl_rl_msgs/NavigatorStatus."""

    WAITING = 0
    SOLVING = 1
    DRIVING = 2
    REACHED = 3
    UNREACHABLE = 4
    BLOCKED = 5
    CANCELLED = 6


@dataclass(frozen=True)
class Goal:
    """A goal position with an optional heading.

    Attributes:
        position: Position in the map frame (2,) [m].
        heading: Final heading [rad]; None for any.
        path: Positions of a path to follow to the goal [m]; None for the shortest time.
    """

    position: tuple[float, float]
    heading: float | None = None
    path: tuple[tuple[float, ...], ...] | None = None


@dataclass(frozen=True)
class NavigatorOptions:
    """Settings of a navigator.

    Attributes:
        tolerance: Distance at which the goal counts as reached [m].
        heading_tolerance: Tolerance of the final heading [rad].
        memory: Time after which an obstacle that was seen only briefly, or before the current goal, is dropped [s].
        max_detour: Maximum time that unmapped obstacles may add to the drive before the robot stops [s].
        period: Control period [s].
        delay: Time from a command to its effect, plus the time until the next one [s].
        deceleration: Braking deceleration of the robot [m/s^2].
        corridor: Distance from a given path within which the robot drives [m].
        inline: Whether to solve value functions synchronously instead of in a thread.
    """

    tolerance: float = 0.15
    heading_tolerance: float = 0.2
    memory: float = 10.0
    max_detour: float = 300.0
    period: float = 0.1
    delay: float = 0.2
    deceleration: float = 0.5
    corridor: float = 0.5
    inline: bool = False


@dataclass(frozen=True)
class Decision:
    """Decision for one control period.

    Attributes:
        command: Speed [m/s] and turn rate [rad/s] (2,).
        state: State of the navigator.
        message: Description of the reason for the state.
        remaining_time: Time to reach the goal [s]; NaN if unknown.
    """

    command: Array
    state: NavigatorState
    message: str
    remaining_time: float = math.nan


def stand(state: NavigatorState, message: str) -> Decision:
    """Return the decision to stand."""
    return Decision(np.zeros(2), state, message, 0.0 if state is NavigatorState.REACHED else math.nan)

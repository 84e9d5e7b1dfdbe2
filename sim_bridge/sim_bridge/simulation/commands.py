"""Command path from network to motors: limits, truncation, delay and time-out."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class CommandChannel:
    """The latest command of a robot as seen by its motors; times are in physics steps."""

    def __init__(self, bounds: Array, idle: Array, truncation: bool = False, delay: int = 0, timeout: int = 0) -> None:
        """Start without a command.

        Args:
            bounds: Minimum and maximum commands (2, 2).
            idle: Command before the first one and after a time-out (2,).
            truncation: Whether to truncate commands to hundredths, as the TurtleBot3 firmware does.
            delay: Physics steps from arrival to effect.
            timeout: Physics steps after which a command expires; 0 for never.
        """
        self._bounds, self._idle = bounds, idle
        self._truncation, self._delay, self._timeout = truncation, delay, timeout
        self._waiting: deque[tuple[int, Array]] = deque()
        self._current, self._expires = idle, -1

    def send(self, command: ArrayLike, step: int) -> bool:
        """Accept a command (2,) that arrives before physics step `step`; return False if it is rejected."""
        values = np.array(command, dtype=float)
        if values.shape != (2,) or not np.isfinite(values).all():
            return False
        values = np.clip(values, self._bounds[:, 0], self._bounds[:, 1])
        if self._truncation:
            values = np.trunc(values * 100.0) / 100.0
        self._waiting.append((step + self._delay, values))
        return True

    def at(self, step: int) -> Array:
        """Return the motor command (2,) in physics step `step`; steps must not decrease."""
        while self._waiting and self._waiting[0][0] <= step:
            begin, self._current = self._waiting.popleft()
            self._expires = begin + self._timeout if self._timeout else -1
        if 0 <= self._expires <= step:
            self._current, self._expires = self._idle, -1
        return self._current

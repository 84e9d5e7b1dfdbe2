"""Notices that a drive does not get on: no nearer for a while, the same stretch again, or ever longer detours."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PATIENCE = 6.0
"""Time without progress after which all surrounding echoes count as obstacles [s]."""
_PROGRESS = 0.5
"""Minimum decrease of the time to reach that counts as progress [s]."""
_SHORT = 1.0
"""Detour that is not worth a word [s]."""
_STOOD = 1.0
"""Pause after which the drive begins anew [s]: the robot stood for a reason of its own."""
_STRETCH = 0.5
"""Length of a stretch [m]."""
_BESIDE, _ALIKE = 0.35, math.cos(math.radians(45.0))
"""Distance [m] and direction within which two stretches are the same."""
_APART = 4
"""Number of stretches that lie between two passes of the same one."""


class Progress:
    """Observes a drive to one goal.

    Attributes:
        tries: Number of times that patience has ended since the last progress.
        detour: Time that obstacles have cost so far, and that the rest of the way will, beyond the map's way [s].
        passes: Number of times that the last stretch was driven in this direction without the time to reach falling.
    """

    def __init__(self) -> None:
        self.begin()

    @property
    def words(self) -> str:
        """The detour in words; "" for none that is worth a word."""
        return "" if self.detour < _SHORT else f"a detour of {self.detour:.0f} s round obstacles"

    def begin(self) -> None:
        """Begin a drive to a goal."""
        self.tries, self.passes, self.detour = 0, 1, 0.0
        self._best, self._best_at, self._noted_at = math.inf, -math.inf, -math.inf
        self._left = math.nan
        self._solved = self._spared = False
        self._place: Array | None = None
        self._stretches: list[tuple[float, float, float, float, float]] = []

    def solved(self) -> None:
        """Note that the next time to reach comes from another value of the same goal."""
        self._solved = True

    def note(self, now: float, place: Array, left: float) -> bool:
        """Note where a driving robot is, and return whether its patience has ended.

        Args:
            now: Steady time [s].
            place: Position of the robot (2,) [m].
            left: Time to reach the goal from there [s], finite.
        """
        if now - self._noted_at > _STOOD:
            self._best_at, self._spared = now, False
        self._noted_at = now
        if self._solved:
            self._compare(now, left)
        if left < self._best - _PROGRESS:
            self._best, self._best_at, self._spared, self.tries = left, now, False, 0
        self._left = left
        self._pass(place, left)
        if now - self._best_at <= PATIENCE:
            return False
        self._best_at = now
        self.tries += 1
        return True

    def _compare(self, now: float, left: float) -> None:
        """Compare the time to reach by another value with that by the last one.

        The robot may have to turn first, so it gets half of its patience back: once, or a robot whose values change all
        the time would be patient for ever.
        """
        if math.isfinite(self._left):
            self.detour += left - self._left
        if not self._spared:
            self._best_at = max(self._best_at, now - 0.5 * PATIENCE)
        self._best, self._solved, self._spared = left, False, True

    def _pass(self, place: Array, left: float) -> None:
        """Count the passes of the last stretch, at its end."""
        if self._place is None:
            self._place = place.copy()
        dx, dy = (place - self._place).tolist()
        length = math.hypot(dx, dy)
        if length < _STRETCH:
            return
        x, y, self._place = float(place[0]), float(place[1]), place.copy()
        before = np.array(self._stretches[:-_APART]).reshape(-1, 5)
        same = np.hypot(before[:, 0] - x, before[:, 1] - y) < _BESIDE
        same &= before[:, 2] * dx + before[:, 3] * dy > _ALIKE * length
        same &= before[:, 4] - _PROGRESS <= left
        when = np.flatnonzero(same)
        self.passes = 1 + int(len(when) > 0) + int((np.diff(when) > _APART).sum())
        self._stretches.append((x, y, dx / length, dy / length, left))

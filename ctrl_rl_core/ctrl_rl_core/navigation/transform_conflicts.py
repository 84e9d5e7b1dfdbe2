"""Detects conflicting transforms: a frame with two parents, or two publishers of one transform. No ROS."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LASTS_S = 2.0
"""Time for which a conflict is reported after it was last seen [s]; a localiser may be replaced once."""
_JUMP, _SWING = 0.1, 0.2
"""Distance [m] and rotation [rad] between consecutive messages from which a transform counts as jumping ..."""
_SPEED, _RATE = 2.5, 6.0
"""... if it also exceeds the speeds of a robot [m/s, rad/s]."""
_RETURNS = 2
"""Number of jumps back and forth that indicates two publishers rather than a single correction."""
_MOST_PARENTS = 8


@dataclass
class _Child:
    """Transforms received for one child frame.

    Attributes:
        parents: Steady time at which each parent was last seen [s]; infinite for one from /tf_static.
        recent: Last three poses from one parent: parent, stamp [s], position (3,) [m] and heading [rad].
        returns: Steady times [s] of jumps back and forth, with descriptions of their size.
    """

    parents: dict[str, float] = field(default_factory=dict)
    recent: deque[tuple[str, float, Array, float]] = field(default_factory=lambda: deque(maxlen=3))
    returns: deque[tuple[float, str]] = field(default_factory=lambda: deque(maxlen=_RETURNS))


class TransformConflicts:
    """Records transforms and reports conflicts between them."""

    def __init__(self) -> None:
        self._children: dict[str, _Child] = {}

    def note(self, parent: str, child: str, place: Array, yaw: float, stamp: int, now: float, fixed: bool) -> None:
        """Record a transform.

        Args:
            parent: Parent frame.
            child: Child frame.
            place: Position (3,) [m].
            yaw: Heading of the child in the parent [rad].
            stamp: Stamp of the transform [ns].
            now: Steady time [s].
            fixed: Whether the transform was received on /tf_static.
        """
        known = self._children.setdefault(child, _Child())
        if parent in known.parents or len(known.parents) < _MOST_PARENTS:
            known.parents[parent] = math.inf if fixed else now
        if fixed:
            return
        known.recent.append((parent, 1e-9 * stamp, place, yaw))
        if len(known.recent) == 3 and (words := _returned(*known.recent)):
            known.returns.append((now, words))

    def fault(self, frames: list[str], now: float) -> str:
        """Describe conflicts among the transforms to some frames at a steady time [s]; empty if there are none."""
        for child in frames:
            known = self._children.get(child)
            if known is None:
                continue
            parents = sorted(parent for parent, heard in known.parents.items() if now - heard <= LASTS_S)
            if len(parents) > 1:
                return f"{child!r} has two parents: {parents[0]!r} and {parents[1]!r}"
            if len(known.returns) == _RETURNS and now - known.returns[0][0] <= LASTS_S:
                words = f"jumps by {known.returns[-1][1]} to and fro: do two nodes publish it?"
                return f"the transform from {known.recent[-1][0]!r} to {child!r} {words}"
        return ""

    def any_fault(self, now: float) -> str:
        """Describe the first conflict among all frames; empty if there is none."""
        return self.fault(sorted(self._children), now)


def _returned(
    first: tuple[str, float, Array, float],
    second: tuple[str, float, Array, float],
    third: tuple[str, float, Array, float],
) -> str:
    """Describe the size of a jump from the first pose to the second and back; empty if there is none."""
    if not first[0] == second[0] == third[0]:
        return ""
    way, back = (float(np.linalg.norm(each[2] - first[2])) for each in (second, third))
    turn, rest = (abs(math.remainder(each[3] - first[3], 2.0 * math.pi)) for each in (second, third))
    passed = max(abs(second[1] - first[1]), abs(third[1] - second[1]))
    if way > max(_JUMP, _SPEED * passed) and back < 0.5 * way:
        return f"{way:.2f} m"
    return f"{turn:.2f} rad" if turn > max(_SWING, _RATE * passed) and rest < 0.5 * turn else ""

"""Transforms that contradict each other: a frame with two parents, and two publishers of one transform. Pure logic."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LASTS_S = 2.0
"""Time for which a contradiction holds after it was heard last [s]; a localiser may be exchanged once."""
_JUMP, _SWING = 0.1, 0.2
"""Way [m] and turn [rad] from one message to the next from which on a transform jumps ..."""
_SPEED, _RATE = 2.5, 6.0
"""... if it is also faster than a robot [m/s, rad/s]."""
_RETURNS = 2
"""Jumps to and back again that tell two publishers from a correction, which comes once."""
_MOST_PARENTS = 8


@dataclass
class _Child:
    """What was heard of one frame.

    Attributes:
        parents: Steady time at which each parent was heard last [s]; infinite for one of /tf_static.
        recent: The last three poses by one parent: parent, stamp [s], position (3,) [m] and heading [rad].
        returns: Steady times [s] of jumps to and back again, with their size in words.
    """

    parents: dict[str, float] = field(default_factory=dict)
    recent: deque[tuple[str, float, Array, float]] = field(default_factory=lambda: deque(maxlen=3))
    returns: deque[tuple[float, str]] = field(default_factory=lambda: deque(maxlen=_RETURNS))


class TransformConflicts:
    """Notes all transforms, and tells which contradict each other."""

    def __init__(self) -> None:
        self._children: dict[str, _Child] = {}

    def note(self, parent: str, child: str, place: Array, yaw: float, stamp: int, now: float, fixed: bool) -> None:
        """Take a transform.

        Args:
            parent: Frame in which the pose is given.
            child: Frame whose pose it is.
            place: Position (3,) [m].
            yaw: Heading of the child in the parent [rad].
            stamp: Time for which it holds [ns].
            now: Steady time [s].
            fixed: Whether it came on /tf_static.
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
        """Return what contradicts what among the transforms to some frames at a steady time [s]; empty for nothing."""
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
        """Return the first contradiction of all frames; empty for none."""
        return self.fault(sorted(self._children), now)


def _returned(
    first: tuple[str, float, Array, float],
    second: tuple[str, float, Array, float],
    third: tuple[str, float, Array, float],
) -> str:
    """Return the size of a jump from the first pose to the second and back; empty where there is none."""
    if not first[0] == second[0] == third[0]:
        return ""
    way, back = (float(np.linalg.norm(each[2] - first[2])) for each in (second, third))
    turn, rest = (abs(math.remainder(each[3] - first[3], 2.0 * math.pi)) for each in (second, third))
    passed = max(abs(second[1] - first[1]), abs(third[1] - second[1]))
    if way > max(_JUMP, _SPEED * passed) and back < 0.5 * way:
        return f"{way:.2f} m"
    return f"{turn:.2f} rad" if turn > max(_SWING, _RATE * passed) and rest < 0.5 * turn else ""

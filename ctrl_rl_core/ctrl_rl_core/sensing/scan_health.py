"""Detects scans of a dead, covered, frozen or duplicated lidar; no ROS.

Such a lidar still sends scans (zeros, infinities, an old scan, or another robot's), on which a robot must not drive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.sensing.scan import DIRECTIONS, ScanGeometry, ScanView

MIXED = 2.0
"""Time for which the robot stops after scans of two lidars were interleaved [s]; a lidar may be replaced once."""
_STILL = (0.02, 0.05)
"""Odometry speed [m/s] and turn rate [rad/s] below which a robot counts as stationary."""
_SPECKLES = 0.05
"""Fraction of a gap's directions that may have an echo, because a covered lidar sees specks of dust."""
_AHEAD = math.radians(100.0)
"""Angle between gap centre and direction of travel above which the gap does not matter [rad]."""


class LidarIdentity(NamedTuple):
    """Properties that distinguish the scans of two lidars."""

    frame: str
    range_min: float
    range_max: float
    angle_min: float
    counter_clockwise: bool

    def matches(self, other: LidarIdentity) -> bool:
        """Return whether two scans may come from one lidar, whose beam count and first bearing may vary slightly."""
        return self[:3] == other[:3] and self[4] == other[4] and abs(self.angle_min - other.angle_min) <= 0.2


@dataclass
class ScanHealth:
    """Checks consecutive scans.

    Attributes:
        min_echo_share: Minimum fraction of beams with an echo; 0 to disable.
        largest_gap: Maximum angle without echoes ahead [rad]; 2 pi or more to disable.
        frozen_scans: Number of identical scans in motion that indicates a frozen lidar; 0 to disable.
    """

    min_echo_share: float
    largest_gap: float
    frozen_scans: int
    _last: bytes = field(default=b"", repr=False)
    _stamp: int = field(default=0, repr=False)
    _repeated: int = field(default=0, repr=False)
    _identity: LidarIdentity | None = field(default=None, repr=False)
    _mixed_at: float = field(default=-math.inf, repr=False)
    _kinds: str = field(default="", repr=False)

    def update(
        self,
        now: float,
        view: ScanView,
        content: bytes,
        stamp: int,
        identity: LidarIdentity,
        motion: tuple[float, float],
    ) -> str:
        """Check a scan and return the reason why the robot must stop, or "" if the scan is usable.

        Args:
            now: Steady time [s].
            view: Echoes of the scan.
            content: Ranges as received, for comparison with the previous ones.
            stamp: Time stamp of the scan [ns].
            identity: Properties of the lidar that sent the scan.
            motion: Odometry speed [m/s] and turn rate [rad/s].
        """
        frozen, mixed = self._frozen(content, stamp, motion), self._mixed(now, identity)
        if view.share < self.min_echo_share:
            return (
                f"only {100 * view.share:.0f} % of the scan's beams have an echo: "
                "lidar dead, covered or in the open (parameter min_echo_share)"
            )
        if frozen:
            return f"the scan is the same again and again while the robot moves: lidar frozen ({self._repeated} times)"
        return mixed

    def blind(self, view: ScanView, v: float) -> str:
        """Return why the scan does not cover the direction of travel at speed v [m/s], or "" if it does."""
        if v == 0.0 or self.largest_gap >= 2.0 * math.pi:
            return ""
        seen = view.seen if v > 0.0 else np.roll(view.seen, DIRECTIONS // 2)
        known = view.field if v > 0.0 else np.roll(view.field, DIRECTIONS // 2)
        where = "ahead" if v > 0.0 else "behind"
        if not known[_NARROW].any():
            return f"the lidar does not look {where}"
        width = max(1, math.ceil(self.largest_gap * DIRECTIONS / (2.0 * math.pi)))
        if _emptiest(seen | ~known, width) <= _SPECKLES * width:
            return (
                f"no echoes within {math.degrees(self.largest_gap):.0f} deg {where}: "
                "lidar covered, or nothing there (parameter largest_gap)"
            )
        return ""

    def _frozen(self, content: bytes, stamp: int, motion: tuple[float, float]) -> bool:
        """Count repetitions in motion only: a stationary robot in a noise-free simulation sees the same scan."""
        if content != self._last:
            self._repeated = 0
        elif stamp != self._stamp and (abs(motion[0]) > _STILL[0] or abs(motion[1]) > _STILL[1]):
            self._repeated += 1
        self._last, self._stamp = content, stamp
        return 0 < self.frozen_scans <= self._repeated

    def _mixed(self, now: float, identity: LidarIdentity) -> str:
        last, self._identity = self._identity, identity
        if last is not None and not identity.matches(last):
            self._mixed_at = now
            names = sorted({last.frame, identity.frame})
            self._kinds = f"frames {' and '.join(names)}" if len(names) > 1 else "another range or first bearing"
        if 0.0 <= now - self._mixed_at < MIXED:
            return f"scans of two lidars on one topic: {self._kinds}"
        return ""


_NARROW = np.r_[-10:11]


def _emptiest(seen: NDArray[np.bool_], width: int) -> int:
    """Return the minimum number of echoes in `width` consecutive directions centred ahead.

    Args:
        seen: Directions with an echo, counter-clockwise from ahead (DIRECTIONS,).
        width: Number of directions, up to DIRECTIONS.
    """
    span = math.floor(_AHEAD * DIRECTIONS / (2.0 * math.pi))
    begin = -span - width // 2
    ring = np.take(seen, np.arange(begin, span - width // 2 + width), mode="wrap")
    total = np.concatenate(((0,), np.cumsum(ring)))
    return int((total[width:] - total[:-width]).min())


def lidar_identity(frame: str, scan: ScanGeometry) -> LidarIdentity:
    """Return the properties of the lidar that sent a scan."""
    return LidarIdentity(frame, scan.range_min, scan.range_max, scan.angle_min, scan.angle_increment > 0.0)

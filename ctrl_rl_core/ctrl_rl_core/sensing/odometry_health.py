"""Detects odometry whose twist does not match the motion of its pose, without ROS.

Some bases publish a correct pose with a zero twist, or a twist in the wrong frame, unit or direction. Stopping
distances, frozen-lidar checks, states and the driven distance all use the twist, so a robot must not drive on a wrong
one.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.sensing.odometry import make_odometry
from ctrl_rl_core.sensing.pose import yaw_of

Array = NDArray[np.float64]

_WINDOW = 2.0
"""Window over which pose and twist are compared [s]."""
PAUSE = 0.5
"""Interval between stamps beyond which the twist says nothing about the motion [s]."""
_WAY, _TURN = 0.1, 0.4
"""Minimum distance [m] and rotation [rad] of the pose that the twist must explain; less may be noise."""
_EXPLAINED = 0.5
"""Fraction of the pose's motion that the twist must explain; wheel slip and drift stay above it."""
_FEWEST = 4
"""Minimum number of messages in the window for telling a single jump of the pose from motion."""
JUMP = 0.3
"""Distance beyond the twist's prediction above which the odometry origin has changed [m]."""
_EVERY = 0.2
"""Interval between comparisons [s]."""
_Step = tuple[float, float, float, float]
"""Displacement along x, y and z of the odometry frame [m], and rotation [rad]."""
_KINDS = ((slice(3), _WAY, "m", "speeds"), (slice(3, 4), _TURN, "rad", "turn rates"))


class OdometryHealth:
    """Compares pose and twist, message after message.

    A correction of the pose in one message, e.g. by a localiser or a reset, counts as a jump, not as motion. A fault
    lasts until the twist matches the pose again: a robot that is stopped for it cannot provide more evidence.
    """

    def __init__(self) -> None:
        self._steps: deque[tuple[float, _Step, _Step]] = deque()
        self._stamp, self._judged, self._numbers = math.nan, -math.inf, [0.0] * 13
        self._faults = ["", ""]

    @property
    def fault(self) -> str:
        """Description of the contradiction; empty if there is none."""
        return self._faults[0] or self._faults[1]

    def update(self, stamp: int, odometry: Array) -> str:
        """Process odometry (13,) with its stamp [ns], and return `fault`."""
        now, before, last = 1e-9 * stamp, self._stamp, self._numbers
        self._stamp, self._numbers = now, odometry.tolist()
        passed = now - before
        if not 0.0 < passed <= PAUSE:  # the first message, a repetition, a pause, or an adjusted clock
            self._steps.clear()
            self._judged = now
            return self.fault
        moved, told = _moved(last, self._numbers), _told(last, self._numbers, passed)
        if math.hypot(*moved[:3]) > JUMP + 2.0 * math.hypot(*told[:3]):
            self._steps.clear()
            return self.fault
        self._steps.append((now, moved, told))
        while now - self._steps[0][0] > _WINDOW:
            self._steps.popleft()
        if len(self._steps) >= _FEWEST and now - self._judged >= _EVERY:
            self._judged = now
            self._judge()
        return self.fault

    def _judge(self) -> None:
        moved, told = np.array([step[1] for step in self._steps]), np.array([step[2] for step in self._steps])
        usual = np.arange(len(moved)) != np.argmax(np.abs(moved - told).sum(axis=1))
        way, twist = moved[usual].sum(axis=0), told[usual].sum(axis=0)
        for number, (part, least, unit, name) in enumerate(_KINDS):
            size = float(np.linalg.norm(way[part]))
            if size < least:
                continue
            explained = float(way[part] @ twist[part]) / size
            self._faults[number] = (
                f"odometry moves by {size:.2f} {unit} in its pose, of which its {name} explain "
                f"{round(explained, 2) + 0.0:.2f} {unit}: see the twist that the base publishes"
                if explained < _EXPLAINED * size
                else ""
            )


def contradiction(stamps: NDArray[np.int64], poses: Array, speeds: Array) -> str:
    """Describe contradictions in recorded odometry of a wheeled robot; empty if there are none.

    Args:
        stamps: Stamps (n,) [ns].
        poses: Poses x, y, yaw (n, 3) [m, m, rad].
        speeds: Speed and turn rate from the twist (n, 2) [m/s, rad/s].
    """
    health = OdometryHealth()
    for stamp, pose, (v, omega) in zip(stamps.tolist(), poses, speeds.tolist(), strict=True):
        fault = health.update(stamp, make_odometry(pose, np.array((v, 0.0, omega))))
        if fault:
            return fault
    return ""


def _moved(before: list[float], after: list[float]) -> _Step:
    """Return the motion of the pose."""
    turn = math.remainder(yaw_of(*after[3:7]) - yaw_of(*before[3:7]), 2.0 * math.pi)
    return after[0] - before[0], after[1] - before[1], after[2] - before[2], turn


def _told(before: list[float], after: list[float], passed: float) -> _Step:
    """Return the motion predicted by the twists over some time [s], along the previous axes."""
    x, y, z, w = before[3:7]
    a, b, c = (0.5 * passed * (before[place] + after[place]) for place in (7, 8, 9))
    across = (2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a))
    return (
        a + w * across[0] + y * across[2] - z * across[1],
        b + w * across[1] + z * across[0] - x * across[2],
        c + w * across[2] + x * across[1] - y * across[0],
        0.5 * passed * (before[12] + after[12]),
    )

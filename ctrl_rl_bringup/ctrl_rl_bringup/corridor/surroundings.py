"""Surroundings of a recorded drive: moving obstacles, and what the safety filter changed."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.ros import seconds
from numpy.typing import NDArray

from ctrl_rl_bags import read_messages
from ctrl_rl_msgs.msg import SafetyStatus

MOVERS = "/movers"


@dataclass(frozen=True)
class MoverTrack:
    """One moving obstacle.

    Attributes:
        radius: Radius of the cylinder [m].
        track: Time since the start, x, y (n, 3) [s, m, m].
    """

    radius: float
    track: NDArray[np.float64]

    def at(self, time: float) -> tuple[float, float]:
        """Return its position [m] at a time since the start [s]."""
        x, y = (np.interp(time, self.track[:, 0], self.track[:, column]) for column in (1, 2))
        return float(x), float(y)


def read_movers(bag: Path, begin: float) -> tuple[MoverTrack, ...]:
    """Return the movers of a bag of a ground robot, in the order of the task file.

    Args:
        bag: Folder of the bag.
        begin: Stamp of the start [s].
    """
    radii: dict[int, float] = {}
    rows: dict[int, list[tuple[float, float, float]]] = defaultdict(list)
    for message in read_messages(bag, [MOVERS]):
        data: Any = message.data
        time = seconds(data.header.stamp) - begin
        for mover in data.movers:
            radii[mover.id] = mover.radius
            rows[mover.id].append((time, mover.position.x, mover.position.y))
    return tuple(MoverTrack(radii[number], np.array(rows[number])) for number in sorted(rows))


FILTER, GUARD = "/safety_filter/status", "/flight_guard/status"
_MODES = {
    "passed": SafetyStatus.PASSED,
    "corrected": SafetyStatus.CORRECTED,
    "escaping": SafetyStatus.ESCAPING,
    "unblocking": SafetyStatus.UNBLOCKING,
    "evading": SafetyStatus.EVADING,
    "waiting": SafetyStatus.WAITING,
}
_STOPPED = 0.01
_LONGEST = 1.0
"""Time between two commands that means that the simulation stood still [s]."""


@dataclass(frozen=True)
class FilterRecord:
    """The answers of the safety filter, or of a quadrotor's flight guard, one per row.

    Attributes:
        times: Times since the start (n,) [s].
        modes: Kinds of the answers, constants of SafetyStatus (n,); the first four match FlightStatus.
        raw: Raw commands (n, 2) [m/s, rad/s]; thrusts [N].
        sent: Commands that were sent instead (n, 2) [m/s, rad/s]; thrusts [N].
        margins: Margins of the certificates, or room of the guard's escapes (n,) [m]; NaN where there is none.
        flies: Whether they are a flight guard's.
    """

    times: NDArray[np.float64]
    modes: NDArray[np.int64]
    raw: NDArray[np.float64]
    sent: NDArray[np.float64]
    margins: NDArray[np.float64]
    flies: bool = False

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Whether the command sent differed from the raw one (n,)."""
        return np.asarray(self.modes != SafetyStatus.PASSED)

    @property
    def held(self) -> float:
        """Time for which the robot was held at rest while the raw command asked for motion [s]."""
        held = (np.abs(self.raw[:, 0]) > _STOPPED) & (np.abs(self.sent[:, 0]) <= _STOPPED)
        return float(np.minimum(np.diff(self.times), _LONGEST)[held[:-1]].sum())

    @property
    def changes(self) -> int:
        """Number of times that the filter started or stopped changing commands."""
        return int(np.count_nonzero(np.diff(self.changed)))

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as plain JSON values."""
        certified = self.margins[np.isfinite(self.margins)]
        driven: dict[str, Any] = {} if self.flies else {"held_s": self.held, "speed_taken_off_m_s": self._taken_off}
        return {
            "commands": len(self.times),
            **{name: int(np.count_nonzero(self.modes == mode)) for name, mode in _MODES.items()},
            "changes": self.changes,
            **driven,
            "least_margin_m": float(certified.min()) if len(certified) else None,
        }

    def text(self) -> list[str]:
        """Return the figures for people."""
        counts = [(name, np.count_nonzero(self.modes == mode)) for name, mode in _MODES.items()]
        shares = ", ".join(f"{100.0 * count / len(self.times):.1f} % {name}" for name, count in counts if count)
        if self.flies:
            return [
                f"flight guard        {len(self.times)} answers: {shares}",
                f"                    {self.changes} changes, escapes keep {np.nanmin(self.margins):.3f} m at least",
            ]
        return [
            f"safety filter       {len(self.times)} commands: {shares}",
            f"                    robot held for {self.held:.1f} s, {self.changes} changes, "
            f"{self._taken_off:.3f} m/s taken off on average",
        ]

    @property
    def _taken_off(self) -> float:
        return float(np.abs(self.raw[:, 0] - self.sent[:, 0]).mean())


def read_filter(bag: Path, begin: float, end: float, topic: str = FILTER) -> FilterRecord | None:
    """Return the answers of filter or guard between two stamps [s]; None if there are none."""
    rows, flies = [], topic == GUARD
    for message in read_messages(bag, [topic]):
        data: Any = message.data
        at = seconds(data.header.stamp)
        if not begin <= at <= end:
            continue
        if flies:
            commands = data.raw_t1, data.raw_t2, data.t1, data.t2, data.room
        else:
            commands = data.raw_speed, data.raw_turn_rate, data.speed, data.turn_rate, data.margin
        rows.append((at - begin, data.mode, *commands))
    if not rows:
        return None
    table = np.array(rows)
    return FilterRecord(table[:, 0], table[:, 1].astype(np.int64), table[:, 2:4], table[:, 4:6], table[:, 6], flies)

"""What the page shows, as plain arrays: `Scene`, which a source fills and the page draws."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap

Array = NDArray[np.float64]
Pose = tuple[float, float, float]

PERIOD_S = 0.1
"""Shortest time between two frames [s]."""
MOST_NOTES, LONGEST_NOTE = 40, 300
"""Limits of the texts: their number, and the letters of each."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Heights over the plane of positions.

    Attributes:
        heights: 0 at the best value, 1 at the worst, NaN where unreachable or unknown (rows, columns).
        cell: Distance between columns and between rows [m].
        origin: Position of the value of row 0, column 0, and direction of the rows: x, y, yaw [m, m, rad].
    """

    heights: Array
    cell: float
    origin: Pose


@dataclass(frozen=True, eq=False)
class Grid:
    """A picture of percentages, such as the safety filter's set.

    Attributes:
        percent: 0 to 100, or -1 for unknown (rows, columns).
        cell: Side length of a cell [m].
        origin: Outer corner of cell (0, 0) and direction of the rows: x, y, yaw [m, m, rad].
    """

    percent: NDArray[np.int8]
    cell: float
    origin: Pose


@dataclass(frozen=True, eq=False)
class Escape:
    """The manoeuvre that the safety filter keeps ready.

    Attributes:
        points: Positions (n, 2) [m].
        colour: Red, green, blue of the filter's mode, 0 to 1.
    """

    points: Array
    colour: tuple[float, float, float]


@dataclass(frozen=True)
class Note:
    """A line of text about the robot.

    Attributes:
        text: The text.
        level: 0 fine, 1 warning, 2 error, 3 stale, as in diagnostic_msgs/DiagnosticStatus.
    """

    text: str
    level: int = 0


@dataclass
class Scene:
    """Everything on the page, in the frame of the map.

    A source replaces an array by a new one and never changes its content, so that the page knows by identity what it
    has to draw anew. Only the latest of each kind is kept, however many messages arrive.

    Attributes:
        pose: Pose of the robot [m, m, rad]; None while it is unknown.
        scan: Echoes of the latest scan (n, 2) [m].
        map: Map, or None.
        path: Planned path (n, 2) [m].
        value: Slice of a value function, or None.
        safe_set: Slice of the filter's recoverable set, or None.
        escape: The filter's escape, or None.
        goal: Goal [m, m]; None without one.
        raw: The driver's command, speed [m/s] and turn rate [rad/s]; None if unknown.
        sent: Command that the robot got, or the filter's answer; None if unknown.
        notes: Texts by source: the navigator's state, the filter's reason, diagnostics, faults.
    """

    pose: Pose | None = None
    scan: Array = field(default_factory=lambda: np.zeros((0, 2)))
    map: OccupancyMap | None = None
    path: Array = field(default_factory=lambda: np.zeros((0, 2)))
    value: Surface | None = None
    safe_set: Grid | None = None
    escape: Escape | None = None
    goal: tuple[float, float] | None = None
    raw: tuple[float, float] | None = None
    sent: tuple[float, float] | None = None
    notes: dict[str, Note] = field(default_factory=dict)

    def say(self, source: str, text: str, level: int = 0) -> None:
        """Show a text about a source in place of its last one; an empty text removes it."""
        source = source[:LONGEST_NOTE]
        if not text:
            self.notes.pop(source, None)
        elif source in self.notes or len(self.notes) < MOST_NOTES:
            self.notes[source] = Note(text[:LONGEST_NOTE], level)

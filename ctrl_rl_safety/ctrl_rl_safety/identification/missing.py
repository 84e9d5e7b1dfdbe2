"""Measures how often a lidar misses what its beams hit, from scans of surfaces that do not move.

A beam that measures the same distance in one scan and in the next but one hit the same surface in between. If the scan
in between has no echo there, or one beyond, it missed. Edges, where noise decides what a beam hits, do not count.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.sensing import measured
from numpy.typing import NDArray

from ctrl_rl_bags import BagError, open_bag, read_messages
from ctrl_rl_core import ScanError, read_scan
from ctrl_rl_safety.errors import SafetyError

Array = NDArray[np.float64]

_TYPE = "sensor_msgs/msg/LaserScan"
_SAME = 0.04
"""Maximum difference between two distances to one surface [m]."""
_BEYOND = 0.2
"""Distance behind a surface from which on an echo shows that the surface was missed [m]."""
_SMOOTH = 0.15
"""Maximum difference between neighbouring beams on a surface [m]."""
_LONGEST = 0.5
"""Longest interval between two scans that are compared [s]."""
_FEWEST = 2000
"""Fewest beams that tell a rate."""
_SIGMAS = 3.0
"""Standard deviations by which the rate may be higher than its estimate."""


class Missing(NamedTuple):
    """How often a lidar missed surfaces.

    Attributes:
        beams: Number of beams that hit a surface.
        missed: Number of those without its echo.
    """

    beams: int
    missed: int

    @property
    def rate(self) -> float:
        """Fraction of the beams without an echo."""
        return self.missed / self.beams

    @property
    def bound(self) -> float:
        """Upper bound of the rate, by the number of beams."""
        return self.rate + _SIGMAS * math.sqrt(max(self.rate * (1.0 - self.rate), 1.0 / self.beams) / self.beams)


def read_missing(bag: Path) -> Missing | None:
    """Return how often the lidar of a bag missed surfaces; None if the bag has no scans, or too few beams to tell.

    Raises:
        SafetyError: Several topics have scans, or the bag or a scan is damaged.
    """
    try:
        with open_bag(bag) as opened:
            topics = [name for name, info in opened.info.topics.items() if info.type == _TYPE and info.message_count]
        if not topics:
            return None
        if len(topics) > 1:
            raise SafetyError(f"{bag}: scans on several topics: {', '.join(topics)}: record one lidar")
        found = count_missing(_scans(bag, topics[0]))
    except (BagError, ScanError) as error:
        raise SafetyError(f"{bag}: {error}") from None
    return found if found.beams >= _FEWEST else None


def count_missing(scans: Iterable[tuple[float, Array]]) -> Missing:
    """Count the beams that hit a surface, and those that missed it.

    Args:
        scans: Time [s] and distances of the beams (n,) [m] of each scan in order: +inf for no echo, NaN for none
            measured.
    """
    beams, missed = 0, 0
    last: list[tuple[float, Array]] = []
    for each in scans:
        if last and (len(each[1]) != len(last[-1][1]) or not 0.0 < each[0] - last[-1][0] <= _LONGEST):
            last = []
        last = [*last[-2:], each]
        if len(last) < 3:
            continue
        before, between, after = (distances for _, distances in last)
        with np.errstate(invalid="ignore"):
            surface = np.abs(after - before) < _SAME
            for side in (-1, 1):
                surface &= np.abs(np.roll(before, side) - before) < _SMOOTH
            seen = np.abs(between - before) < _BEYOND
            unseen = ~np.isfinite(between) | (between > before + _BEYOND)
        missed += int((surface & unseen).sum())
        beams += int((surface & (seen | unseen)).sum())
    return Missing(beams, missed)


def _scans(bag: Path, topic: str) -> Iterator[tuple[float, Array]]:
    for each in read_messages(bag, (topic,)):
        ranges, scan = read_scan(each.data)
        scan.check()
        yield 1e-9 * each.log_time, measured(ranges, scan)

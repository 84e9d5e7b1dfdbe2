"""Where a bag contradicts the walls of a task's file: places at which most beams that look there say the same.

A wall that moved is contradicted by all beams that meet it, at any time. Something that moves is met by a few, and the
others pass through where it was.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label

from ctrl_rl_core import World
from ctrl_rl_learning.offline.witness.beams import AGREES, LONGER, SHORTER, Beams
from ctrl_rl_learning.offline.witness.cells import Cells
from ctrl_rl_learning.offline.witness.movers import MoverReach

Array = NDArray[np.float64]
Kind = Literal["unknown", "missing", "mover"]
_STANDS = 0.2
"""Share of the beams near a cell that must end there for a wall: many graze it, and count in several cells."""
_GONE = 0.5
"""Share of the beams towards a piece of wall that must go farther for it to be gone."""
_FEWEST_BEAMS, _FEWEST_SCANS, _LEAST_SHARE = 10, 3, 1e-4
"""Numbers of beams and scans, and share of all beams, that must show a place."""
_PIECE = 0.1
"""Length of a piece of wall that beams vote on [m]."""
_LOOK = 20
"""Number of scans of an episode that are one look: errors of the pose are the same in all of them."""
_FAR_SIDE = 0.75
"""Quantile of the distances at a place that is told: beside the file's wall a moved one begins at none."""
_CONFIDENCE = 1.96
_LEAST_CLEARANCE, _BESIDE = 0.2, 4
"""Distance from walls, of the file [m] and of the bag [cells], from which on a mover is told from a wrong pose."""
_JOIN = 2
"""Cells over which neighbours are one place."""


@dataclass(frozen=True)
class Place:
    """A place where a bag contradicts the file.

    Attributes:
        kind: "unknown" for a wall that the file does not have, "missing" for one of the file that is not there, "mover"
            for something that is there at times.
        centre: Its middle (2,) [m].
        size: Its extent along x and y (2,) [m].
        off: How far it is from where the file has a wall; of a missing wall, how much farther beams go [m].
        beams: Number of beams that show it.
        episodes: Number of episodes in which they do.
        looks: Number of looks that show it: some seconds of an episode each.
        looks_there: Number of all looks at it.
    """

    kind: Kind
    centre: tuple[float, float]
    size: tuple[float, float]
    off: float
    beams: int
    episodes: int
    looks: int
    looks_there: int

    @property
    def sure(self) -> bool:
        """Whether most looks there would show it, whatever was wrong with the pose in some (Wilson 1927)."""
        share, z = self.looks / self.looks_there, _CONFIDENCE**2 / self.looks_there
        half = _CONFIDENCE * np.sqrt(share * (1.0 - share) / self.looks_there + 0.25 * z / self.looks_there)
        return bool((share + 0.5 * z - half) / (1.0 + z) > 0.5)

    def __str__(self) -> str:
        """Say it in one line."""
        x, y = self.centre
        drives = "1 episode" if self.episodes == 1 else f"{self.episodes} episodes"
        where, by = f"({x:.1f}, {y:.1f}) m", f"seen by {self.beams} beams of {drives}"
        wide = f"{max(self.size[0], 0.1):.1f} m x {max(self.size[1], 0.1):.1f} m"
        perhaps = "" if self.sure else "perhaps "
        if self.kind == "missing":
            return (
                f"{perhaps}the file's wall at {where} is not there: beams go {self.off:.2f} m farther over {wide}, {by}"
            )
        if self.kind == "mover":
            return f"something that moves, or was there at times, at {where}: over {wide}, {by}"
        return f"{perhaps}a wall at {where} that the file does not have, {self.off:.2f} m from the file's: {wide}, {by}"


def find_places(beams: Beams, world: World, reach: MoverReach) -> tuple[Place, ...]:
    """Return the places where beams contradict a task file's world, those with the most beams first.

    Args:
        beams: Beams with their votes.
        world: Walls of the file.
        reach: Area that the file's movers can reach; beams that end there are no contradiction.
    """
    if not len(beams):
        return ()
    beams = beams.rows((beams.votes != SHORTER) | ~reach.holds(beams.ends))
    ends = beams.ends
    grid = Cells.around(ends.min(axis=0), ends.max(axis=0))
    found = [*_new_ones(beams, world, grid), *_missing_ones(beams, grid)]
    least = _LEAST_SHARE * len(beams)
    return tuple(sorted((place for place in found if place.beams >= least), key=lambda place: -place.beams))


def _new_ones(beams: Beams, world: World, grid: Cells) -> list[Place]:
    """Return walls that the file does not have, and what was there at times."""
    nearer = beams.rows(beams.votes == SHORTER)
    if not len(nearer):
        return []
    ends = nearer.ends
    # Hits of beams that agree with the file do not count: a beam that ends just before a wall would join that wall.
    hits, passes = _sums(grid.count(ends)), _sums(grid.passes(beams))
    stands = hits >= _STANDS * (hits + passes)
    still = stands.ravel()[grid.index(ends)]
    off = world.signed_distance(ends)
    near_walls = binary_dilation(stands & (hits > 0), iterations=_BESIDE).ravel()[grid.index(ends)]
    passing = ~still & ~near_walls & (off > _LEAST_CLEARANCE)
    return [
        *_clusters("unknown", nearer.rows(still), ends[still], off[still], grid),
        *_clusters("mover", nearer.rows(passing), ends[passing], off[passing], grid),
    ]


def _sums(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sums over each cell and its eight neighbours."""
    padded = np.pad(counts, 1)
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]


def _missing_ones(beams: Beams, grid: Cells) -> list[Place]:
    """Return walls of the file that are not there."""
    asked = beams.rows(np.isfinite(beams.expected) & ((beams.votes == LONGER) | (beams.votes == AGREES)))
    if not len(asked):
        return []
    rows, columns = np.ceil(np.array(grid.shape) * (grid.resolution / _PIECE)).astype(int).tolist()
    pieces = Cells(grid.corner, _PIECE, (rows, columns))
    at = pieces.index(asked.expected_ends)
    farther = asked.votes == LONGER
    count = int(np.prod(pieces.shape))
    share = np.bincount(at, farther, count) / np.maximum(np.bincount(at, minlength=count), 1)
    gone = farther & (share[at] >= _GONE)
    shown, agreeing = asked.rows(gone), asked.rows(~farther)
    return _clusters("missing", shown, shown.expected_ends, shown.off, grid, agreeing)


def _clusters(
    kind: Kind, beams: Beams, at: Array, off: Array, grid: Cells, against: Beams | None = None
) -> list[Place]:
    """Return the places of beams that end `at` (M, 2), off by (M,) [m]; neighbouring cells are one place.

    Args:
        kind: Kind of the places.
        beams: Beams that show them.
        at: Where they do [m].
        off: How far that is from its place by the file [m].
        grid: Cells by which beams are neighbours.
        against: Beams that would have ended there, and did.
    """
    if not len(beams):
        return []
    names, number = label(binary_dilation(grid.count(at) > 0, iterations=_JOIN))
    of, looks = names.ravel()[grid.index(at)], _looks(beams)
    others = np.empty(0, np.intp) if against is None else names.ravel()[grid.index(against.expected_ends)]
    other_looks = np.empty(0, np.int64) if against is None else _looks(against)
    out = []
    for name in range(1, number + 1):
        chosen = of == name
        if chosen.sum() < _FEWEST_BEAMS or len(np.unique(beams.scans[chosen])) < _FEWEST_SCANS:
            continue
        low, high = np.quantile(at[chosen], (0.02, 0.98), axis=0)
        (x, y), (wide, tall) = (0.5 * (low + high)).tolist(), (high - low).tolist()
        shown = _most_of(looks[chosen], other_looks[others == name])
        distance, count = float(np.quantile(np.abs(off[chosen]), _FAR_SIDE)), int(chosen.sum())
        episodes = len(np.unique(beams.episodes[chosen]))
        out.append(Place(kind, (x, y), (wide, tall), distance, count, episodes, int(shown.sum()), len(shown)))
    return out


def _looks(beams: Beams) -> NDArray[np.int64]:
    """Return the number of the look of each beam (M,)."""
    return beams.episodes * (1 + int(beams.scans.max(initial=0))) + beams.scans // _LOOK


def _most_of(shows: NDArray[np.int64], denies: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether most beams of each look (looks,) show a place, by the looks of those that do and do not."""
    looks, which = np.unique(np.concatenate((shows, denies)), return_inverse=True)
    votes = np.concatenate((np.ones(len(shows)), -np.ones(len(denies))))
    return np.asarray(np.bincount(which, votes, len(looks)) > 0.0)

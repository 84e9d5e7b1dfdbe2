"""What recorded drives say against a task's file: lines to tell, and whether its walls may be learnt and judged by.

account = examine(witness.record(), task)
account.lines        # each difference in one line
account.refusal      # why nothing may be learnt by value or judged by roll-outs; empty where it may
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, World
from ctrl_rl_learning.offline.witness.beams import LONGER, SHORTER, Beams, FileWalls, compare
from ctrl_rl_learning.offline.witness.episode_worlds import EpisodeWalls, beside_own_walls
from ctrl_rl_learning.offline.witness.frame_search import find_offset
from ctrl_rl_learning.offline.witness.limits import (
    commands_beyond,
    faster_than_robot,
    many_inside,
    states_inside,
)
from ctrl_rl_learning.offline.witness.movers import MoverReach
from ctrl_rl_learning.offline.witness.offset import Offset, fit_offset, without_drift
from ctrl_rl_learning.offline.witness.places import Place, find_places
from ctrl_rl_learning.offline.witness.record import DriveRecord, Sightings

Array = NDArray[np.float64]
_WORTH_A_FIT = 0.01
"""Share of differing beams from which on an offset is looked for."""
_WORTH_A_DRIFT = 0.1
"""Share of differing beams from which on a drift is looked for: it moves all walls."""
_EXPLAINED = 0.5
"""Share of the differing beams that an offset must leave at most to count as one."""
_TOLD_SHIFT, _TOLD_TURN = 0.05, math.radians(1.5)
_REFUSED_SHIFT, _REFUSED_TURN, _REFUSED_DRIFT = 0.10, math.radians(3.0), 0.15
_REFUSED_BEAMS, _REFUSED_OFF = 20, 0.06
"""Number of beams that must show a place, and distance from the file's wall [m], to refuse the file."""
_CORNER = 0.12
"""Extent of a missing wall below which it is taken for a corner that beams just miss [m]."""
_TOLD_WIDTH = 0.02
"""Difference of a corridor's width from the file's that is told [m]."""
_TOLD_SCALE = 0.01
"""Difference of the wheels' radius between episodes that is told."""
_MOST_PLACES = 8


@dataclass(frozen=True)
class Account:
    """What recorded drives say against a task's file.

    Attributes:
        task: Task whose file it is.
        beams: The beams with their votes, at poses freed of the offset; None where walls cannot be compared.
        differing: Share of the beams that differ from the file, at the recorded poses.
        offset: Shift and turn of the recorded poses that explains most of it; None for none.
        drift: How far the poses drift within episodes, where that explains most of it [m]; else 0.
        places: Places at which walls differ, and where something moved.
        paths: Recorded places of each episode (n, 2) [m].
        notes: Other differences, a line each.
        impossible: Those of them after which nothing in the task's model holds.
    """

    task: NavigationTask
    beams: Beams | None
    differing: float
    offset: Offset | None
    drift: float
    places: tuple[Place, ...]
    paths: tuple[Array, ...]
    notes: tuple[str, ...]
    impossible: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        """Each difference in one line, the gravest first."""
        out = list(self.impossible)
        if self.offset is not None:
            out.append(f"the poses lie off the file's frame: moving them by {self.offset} explains most differences")
        if self.drift:
            left = "walls are not compared" if self.drift >= _REFUSED_DRIFT else "too little to matter"
            out.append(f"the poses drift by {self.drift:.2f} m within episodes, as odometry alone does: {left}")
        walls = [place for place in self.places if place.kind != "mover"]
        if walls and self.beams is not None:
            out.append(f"{self.differing:.1%} of {len(self.beams):,} beams differ from the walls of the task's file")
        out += [str(place) for place in walls[:_MOST_PLACES]]
        if len(walls) > _MOST_PLACES:
            out.append(f"walls differ at {len(walls) - _MOST_PLACES} more places")
        movers = [place for place in self.places if place.kind == "mover"]
        if movers and not self.task.movers:
            out += [f"{movers[0]}" + (f", and at {len(movers) - 1} more places" if len(movers) > 1 else "")]
        return [*out, *self.notes]

    @property
    def moved_walls(self) -> list[Place]:
        """Places at which walls differ too much to be believed."""
        walls = [place for place in self.places if place.kind != "mover" and place.sure and not _is_corner(place)]
        return [place for place in walls if place.beams >= _REFUSED_BEAMS and place.off >= _REFUSED_OFF]

    @property
    def refusal(self) -> str:
        """Why nothing may be learnt by value or judged by roll-outs, and what to do; empty where it may."""
        name = self.task.name
        if self.offset is not None and (self.offset.size >= _REFUSED_SHIFT or abs(self.offset.turn) >= _REFUSED_TURN):
            return (
                f"the bags' poses are not in the frame of task '{name}': correct the localisation's start, or move the"
                f" file's walls, start and goal by {self.offset.inverse()}; --method bc needs neither"
            )
        if self.moved_walls:
            return (
                f"the bags show other walls than the file of task '{name}': take them from the bags by --map-from-bag,"
                " or fix the file"
            )
        if self.drift >= _REFUSED_DRIFT and not {"odom_drift", "wheel_radius"} & set(self.task.randomisation):
            return (
                f"the bags' poses drift by {self.drift:.2f} m from the frame of task '{name}': learn by --method bc, "
                "which needs no walls, or record the poses of a localisation, not of odometry alone"
            )
        if self.impossible:
            return (
                f"the bags are not of task '{name}' and its robot: {self.impossible[0]}; name theirs, or fix the file"
            )
        return ""


def examine(record: DriveRecord, task: NavigationTask) -> Account:
    """Compare what drives saw and did with a task's file.

    Walls are compared on the floor only; where a task draws them for each episode, with those that its scans show.
    """
    notes, impossible = [*commands_beyond(record, task)], [*faster_than_robot(record, task)]
    paths = tuple(_paths(record))
    if task.plane != "xy" or not record.sightings:
        return Account(task, None, 0.0, None, 0.0, (), paths, tuple(notes), tuple(impossible))
    found = _at_better_poses(record.sightings, task)
    notes += _walls_of_episodes(found.walls, task)
    inside, count = states_inside(found.seen, task, found.worlds)
    if many_inside(inside, count) and found.offset is None and not found.drift:
        impossible.append(f"{inside} of {count} recorded states lie inside what the file calls a collision")
    # At poses that drift far, what is left of the differences is that of the drift.
    reach = MoverReach(
        task, list(found.worlds.values()) or [task.build_world()], np.random.default_rng(0), wanderers=False
    )
    places = () if found.drift >= _REFUSED_DRIFT else find_places(found.beams, task.build_world(), reach)
    return Account(
        task, found.beams, found.differing, found.offset, found.drift, places, paths, tuple(notes), tuple(impossible)
    )


class _Compared(NamedTuple):
    """Beams at the poses that explain them best.

    Attributes:
        beams: The beams with their votes.
        differing: Share of them that differs at the recorded poses.
        offset: Offset of the recorded poses, if one explains most differences.
        drift: Their drift [m], if it does; else 0.
        walls: Walls of the episodes that have their own.
        worlds: Their worlds.
        seen: Scans at the recorded poses, with ways by the true radius of the wheels.
    """

    beams: Beams
    differing: float
    offset: Offset | None
    drift: float
    walls: Mapping[int, EpisodeWalls]
    worlds: Mapping[int, World]
    seen: Sequence[Sightings]


def _at_better_poses(seen: Sequence[Sightings], task: NavigationTask) -> _Compared:
    """Return the beams at the poses that explain them best, with the offset or the drift of the recorded ones."""
    own = beside_own_walls(seen, task, np.random.default_rng(0))
    beams, worlds = own.beams, own.worlds(task)
    recorded, walls = _Compared(beams, beams.differing, None, 0.0, own.walls, worlds, own.seen), FileWalls(task, worlds)
    if beams.differing <= _WORTH_A_FIT:
        return recorded
    far_off = beams.differing >= _WORTH_A_DRIFT
    found = find_offset(own.seen, walls) if far_off else fit_offset(own.seen, walls)
    at_offset = [found.moved(each) for each in own.seen]
    moved = beside_own_walls(at_offset, task, np.random.default_rng(0))
    told = found if found.size >= _TOLD_SHIFT or abs(found.turn) >= _TOLD_TURN else None
    if moved.beams.differing <= _EXPLAINED * beams.differing and moved.beams.differing < _WORTH_A_DRIFT:
        return recorded._replace(beams=moved.beams, offset=told, walls=moved.walls)
    if not far_off:
        return recorded
    # Odometry drifts, from the file's frame or from one of its own.
    for poses, offset in ((own.seen, None), (at_offset, told)):
        freed = [without_drift(each, walls) for each in poses]
        still, drift = compare([each for each, _ in freed], walls), max(size for _, size in freed)
        if still.differing <= _EXPLAINED * beams.differing and drift >= _TOLD_SHIFT:
            return recorded._replace(beams=still, offset=offset, drift=drift)
    if moved.beams.differing <= _EXPLAINED * beams.differing:
        return recorded._replace(beams=moved.beams, offset=told, walls=moved.walls)
    return recorded


def _walls_of_episodes(walls: Mapping[int, EpisodeWalls], task: NavigationTask) -> Iterator[str]:
    """Yield a line on the walls that the bags show and a task leaves open."""
    if not walls or task.corridor is None:
        return
    widths = [each.width for each in walls.values()]
    if max(abs(width - task.corridor.width) for width in widths) > _TOLD_WIDTH:
        wide = f"{min(widths):.2f} to {max(widths):.2f} m"
        yield f"the corridor is {wide} wide by the scans, {task.corridor.width:g} m by the file"
    scales = [each.scale for each in walls.values()]
    if max(scales) - min(scales) > _TOLD_SCALE:
        yield f"wheels rolled {min(scales):.2f} to {max(scales):.2f} times as far as odometry says, by the scans"
    if task.doorways is not None:
        seen = np.concatenate([each.seen for each in walls.values()])
        yield f"doorways of each episode by its scans: {seen.sum()} of {len(seen)} were seen"


def _is_corner(place: Place) -> bool:
    """Return whether a missing wall is small enough to be a corner that beams miss because of pose errors."""
    return place.kind == "missing" and max(place.size) < _CORNER


def contradicting(beams: Beams) -> tuple[Array, Array]:
    """Return where beams ended that are too short (n, 2), and where the file has walls that beams pass (m, 2) [m]."""
    shorter, longer = beams.rows(beams.votes == SHORTER), beams.rows(beams.votes == LONGER)
    return shorter.ends, longer.expected_ends


def _paths(record: DriveRecord) -> list[Array]:
    return [seen.poses[seen.episodes == number, :2] for seen in record.sightings for number in np.unique(seen.episodes)]

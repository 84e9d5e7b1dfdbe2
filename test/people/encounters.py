"""Encounters of a robot with people, drawn from a seed: a room, a way through it, and people who walk about.

A person walks to and fro along a line at a constant speed, with a pause at either end. It stops for a robot that stands
in its way, or for none at all; it never steps aside and never slows for a robot that drives. It only looks before it
begins to walk: not if a robot is close by.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KINDS = ("crossing", "head-on", "following", "standing", "group")
_LENGTH = 7.0
"""Length of the room [m]."""
_WIDTHS = {"crossing": (2.6, 4.0), "group": (3.6, 5.0)}
_ANY_WIDTH = (1.8, 4.0)
"""Range of its width by kind, from a corridor to a hall [m]."""
_START, _GOAL = 0.8, 5.8
"""Places of start and goal along the room [m]."""
_YIELDING = 0.5
"""Share of people who stop for a robot that stands."""


class Person(NamedTuple):
    """Somebody who walks to and fro.

    Attributes:
        ends: The ends of the way (2, 2) [m].
        begin: Place on it at the start, as a share of the way there and back, 0 to 1.
        speed: Speed [m/s].
        radius: Radius [m].
        gap: Distance to a robot that stands at which it stops [m]; negative for never.
        stands: Time until which it stands at the start of its way [s].
        pause: Time for which it stands at either end of its way [s].
    """

    ends: Array
    begin: float
    speed: float
    radius: float
    gap: float
    stands: float
    pause: float


class _Way(NamedTuple):
    """The robot's way: size of the room, its start, directions along and across it (2,) [m], and its speed [m/s]."""

    room: Array
    start: Array
    along: Array
    across: Array
    speed: float


class Encounter(NamedTuple):
    """One drive's world.

    Attributes:
        room: Size of the room, whose corner is the origin (2,) [m].
        start: Pose at the start (3,) [m, m, rad].
        goal: Position of the goal (2,) [m].
        people: People in it.
    """

    room: Array
    start: Array
    goal: Array
    people: list[Person]


def draw(kind: str, seed: int, robot_speed: float) -> Encounter:
    """Draw an encounter of a kind, one of `KINDS`."""
    random = np.random.default_rng((seed, KINDS.index(kind)))
    room = np.array((_LENGTH, random.uniform(*_WIDTHS.get(kind, _ANY_WIDTH))))
    start = np.array((_START, random.uniform(0.3, 0.7) * room[1], random.uniform(-0.5, 0.5)))
    goal = np.array((_GOAL, random.uniform(0.3, 0.7) * room[1]))
    way = goal - start[:2]
    along = way / math.hypot(*way)
    across = np.array((-along[1], along[0]))
    person = _DRAWN[kind] if kind != "group" else (_head_on if seed % 2 else _crossing)
    count = int(random.integers(3, 5)) if kind == "group" else 1
    people = [person(random, _Way(room, start[:2], along, across, robot_speed), index) for index in range(count)]
    return Encounter(room, start, goal, people)


def _person(
    random: np.random.Generator, way: _Way, ends: Array, begin: float, speed: float, stands: float = 0.0
) -> Person:
    gap = random.uniform(0.1, 0.3) if random.random() < _YIELDING else -1.0
    radius = random.uniform(0.18, 0.28)
    low, high = np.full(2, radius + 0.05), way.room - radius - 0.05
    return Person(np.clip(ends, low, high), begin, speed, radius, gap, stands, random.uniform(1.0, 5.0))


def _crossing(random: np.random.Generator, way: _Way, index: int) -> Person:
    """Walk across the robot's way so as to meet it there."""
    speed, at = random.uniform(0.3, 0.7), random.uniform(1.2, 3.5)
    turn = random.uniform(-0.5, 0.5)
    direction = (math.cos(turn) * way.across + math.sin(turn) * way.along) * random.choice((-1.0, 1.0))
    middle = way.start + at * way.along
    # As long a way as fits into the room, with the meeting on it.
    ends = np.array([_to_wall(way.room, middle, sign * direction) for sign in (-1.0, 1.0)])
    length, before = math.dist(*ends), math.dist(ends[0], middle)
    meets = at / way.speed + random.uniform(-1.5, 1.5) + 0.8 * index
    return _person(random, way, ends, ((before - speed * meets) / (2.0 * length)) % 1.0, speed)


def _head_on(random: np.random.Generator, way: _Way, index: int) -> Person:
    """Come towards the robot, and go back."""
    aside = random.uniform(-0.3, 0.3) + (index * 0.65 - 0.65 if index else 0.0)
    far = way.start + random.uniform(4.2, 5.2) * way.along + aside * way.across
    ends = np.array((far, way.start - 0.4 * way.along + aside * way.across))
    return _person(random, way, ends, 0.0, random.uniform(0.3, 0.7))


def _following(random: np.random.Generator, way: _Way, _: int) -> Person:
    """Go the robot's way: ahead of it and slower, or behind and faster."""
    aside, slower = random.uniform(-0.3, 0.3), random.random() < 0.5
    first = way.start + (1.0 if slower else -0.6) * way.along + aside * way.across
    ends = np.array((first, way.start + 5.2 * way.along + aside * way.across))
    speed = random.uniform(0.5, 0.9) * way.speed if slower else random.uniform(0.3, 0.6)
    return _person(random, way, ends, 0.0, speed, 0.0 if slower else random.uniform(2.0, 6.0))


def _standing(random: np.random.Generator, way: _Way, _: int) -> Person:
    """Stand in the way, for a while or for ever, and then walk on across it."""
    place = way.start + random.uniform(1.5, 3.5) * way.along + random.uniform(-0.2, 0.2) * way.across
    until = math.inf if random.random() < 0.5 else random.uniform(4.0, 20.0)
    return _person(
        random, way, np.array((place, _to_wall(way.room, place, way.across))), 0.0, random.uniform(0.3, 0.7), until
    )


_DRAWN = {"crossing": _crossing, "head-on": _head_on, "following": _following, "standing": _standing}


def _to_wall(room: Array, place: Array, direction: Array) -> Array:
    """Return where a line from a place leaves the room."""
    ways = [
        ((size if step > 0.0 else 0.0) - at) / step
        for at, step, size in zip(place, direction, room, strict=True)
        if abs(step) > 1e-9
    ]
    return np.asarray(place + max(min(ways) - 0.4, 0.0) * direction)

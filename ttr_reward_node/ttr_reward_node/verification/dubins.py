"""Shortest Dubins paths (Dubins 1957; words as in Shkel, Lumelsky 2001) to a box of poses.

The car drives at 1 m/s and turns at up to 1 rad/s, so lengths [m] equal times [s]. The distance to a box is the minimum
over the words that lead to it. It is searched in two ways: over the two free parameters of each word, and over the end
poses in the box; first on a lattice, then by a compass search from the best few.
"""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

from ttr_reward_node.verification.dubins_words import TURNS, end_of, positive, word

Array = NDArray[np.float64]
MOVES = np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]], dtype=np.float64)
_GRAZE = 1e-9  # rounding: a box missed by less counts as met
_HEADINGS, _AIMS = 9, 40  # arrival headings and first turns tried per word with a straight segment
_LATTICE, _ENDS = 7, 3  # end poses per side of the box, and number of them to refine
_TURNS = 24  # number of first and of second turns tried per word of three turns
_STARTS = 2  # number of starts to refine per word
_THREE_TURNS = 6.0  # largest distance covered by three turns


@cached_njit
def _reach(x: float, y: float, direction: float, box: Array) -> float:
    """Return the distance from a point along a direction to the box's positions; inf if the ray misses them."""
    near, far = 0.0, math.inf
    for k in range(2):
        start, slope = (x, math.cos(direction)) if k == 0 else (y, math.sin(direction))
        if abs(slope) < 1e-12:
            if not box[k, 0] - _GRAZE <= start <= box[k, 1] + _GRAZE:
                return math.inf
        else:
            one, two = (box[k, 0] - start) / slope, (box[k, 1] - start) / slope
            near, far = max(near, min(one, two)), min(far, max(one, two))
    return near if near <= far + _GRAZE else math.inf


@cached_njit
def _base(kind: int, pose: Array, end: float, direction: float) -> tuple[float, float]:
    """Return the displacement of the two turns of a word without its straight segment, from `pose` to heading `end`."""
    x, y, a = pose
    one, two = TURNS[kind, 0], TURNS[kind, 2]
    x += one * (math.sin(direction) - math.sin(a)) + two * (math.sin(end) - math.sin(direction))
    y -= one * (math.cos(direction) - math.cos(a)) + two * (math.cos(end) - math.cos(direction))
    return x, y


@cached_njit
def _straight_word(kind: int, pose: Array, end: float, t: float, box: Array) -> tuple[float, float]:
    """Return segments p and q of a word with a straight segment, for first turn t and arrival heading `end`.

    p is inf if the straight segment misses the box.
    """
    a = pose[2]
    direction = a + TURNS[kind, 0] * t
    q = positive(TURNS[kind, 2] * (end - direction))
    x, y = _base(kind, pose, end, direction)
    return _reach(x, y, direction, box), q


@cached_njit
def _aim(kind: int, pose: Array, end: float, box: Array, i: int) -> float:
    """Return candidate i for the first turn: towards corners, centre and sides of the box, then evenly spaced."""
    a, turn = pose[2], TURNS[kind, 0]
    if i == 0:
        return 0.0
    if i == 1:  # so far that no last turn is needed
        return positive(turn * (end - a))
    if i < 12:
        target, other = divmod(i - 2, 2)
        if target == 4:
            cx, cy = 0.5 * (box[0, 0] + box[0, 1]), 0.5 * (box[1, 0] + box[1, 1])
        else:
            cx, cy = box[0, target % 2], box[1, target // 2]
        # Exclude the part of the turns' displacement that depends on the direction of the straight segment.
        opposite = TURNS[kind, 2] != turn
        x = pose[0] - turn * math.sin(a) + TURNS[kind, 2] * math.sin(end)
        y = pose[1] + turn * math.cos(a) - TURNS[kind, 2] * math.cos(end)
        rho, beta = math.hypot(cx - x, cy - y), math.atan2(cy - y, cx - x)
        if opposite and rho < 2.0:
            return 0.0
        lean = math.asin(2.0 * turn / rho) if opposite else 0.0
        return positive(turn * ((beta + lean if other == 0 else beta + math.pi - lean) - a))
    if i < 16:  # along the axes
        return positive(turn * ((i - 12) * 0.5 * math.pi - a))
    return 2.0 * math.pi * (i - 16) / (_AIMS - 16)


@cached_njit
def _arrive(kind: int, pose: Array, t: float, p: float, box: Array) -> float:
    """Return the last segment q of a word of three turns until it enters the box; inf if it misses the box."""
    x, y, a = end_of(kind, t, p, 0.0, pose[0], pose[1], pose[2], t + p)
    turn = TURNS[kind, 2]
    cx, cy = x - turn * math.sin(a), y + turn * math.cos(a)
    best = math.inf
    for i in range(11):
        if i == 0:
            q = 0.0
        elif i < 3:
            q = positive(turn * (box[2, i - 1] - a))
        else:  # x = cx + turn sin, y = cy - turn cos
            k, side, other = (i - 3) // 4, ((i - 3) // 2) % 2, (i - 3) % 2
            value = turn * (box[0, side] - cx) if k == 0 else -turn * (box[1, side] - cy)
            if abs(value) > 1.0:
                continue
            heading = math.asin(value) if k == 0 else math.acos(value)
            if other == 1:
                heading = math.pi - heading if k == 0 else -heading
            q = positive(turn * (heading - a))
        if q < best and _inside(
            cx + turn * math.sin(a + turn * q), cy - turn * math.cos(a + turn * q), a + turn * q, box
        ):
            best = q
    return best


@cached_njit
def _inside(x: float, y: float, a: float, box: Array) -> bool:
    """Whether a pose lies in the box, up to rounding."""
    turned = (a - box[2, 0] + _GRAZE) % (2.0 * math.pi)
    at = box[0, 0] - _GRAZE <= x <= box[0, 1] + _GRAZE and box[1, 0] - _GRAZE <= y <= box[1, 1] + _GRAZE
    return at and turned <= box[2, 1] - box[2, 0] + 2.0 * _GRAZE


@cached_njit
def _path(kind: int, pose: Array, one: float, two: float, box: Array) -> tuple[float, float, float]:
    """Return the segments of a word for its two free parameters; inf if it does not lead to the box.

    The parameters are the arrival heading and the first turn of a word with a straight segment, or the first two of
    three turns.
    """
    if kind < 4:
        if not box[2, 0] <= one <= box[2, 1]:
            return two, math.inf, 0.0
        p, q = _straight_word(kind, pose, one, two, box)
        return two, p, q
    return one, two, _arrive(kind, pose, one, two, box)


@cached_njit
def _refine(kind: int, pose: Array, one: float, two: float, box: Array) -> tuple[float, float, float]:
    """Optimise the two free parameters of a word, one at a time and jointly, and return its segments."""
    t, p, q = _path(kind, pose, one, two, box)
    step = 0.1
    while step > 1e-7:
        better = False
        for k in range(8):
            u = one + step * MOVES[k, 0]
            v = two + step * MOVES[k, 1]
            u = min(max(u, box[2, 0]), box[2, 1]) if kind < 4 else max(u, 0.0)
            v = max(v, 0.0)
            a, b, c = _path(kind, pose, u, v, box)
            if a + b + c < t + p + q - 1e-12:
                one, two, t, p, q, better = u, v, a, b, c, True
        if not better:
            step /= 2.0
    return t, p, q


@cached_njit
def _segments(kind: int, pose: Array, end: Array) -> tuple[float, float, float]:
    """Return the segments of a word from one pose to another."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = end[0] - pose[0], end[1] - pose[1]
    segments: tuple[float, float, float] = word(kind, c * dx + s * dy, -s * dx + c * dy, end[2] - pose[2])
    return segments


@cached_njit
def _between(kind: int, pose: Array, box: Array) -> tuple[float, float, float]:
    """Return the segments of a word to the best pose in the box, including its corners and edges."""
    size = box[:, 1] - box[:, 0]
    found = np.full(_LATTICE**3, math.inf)
    end = np.empty(3)
    for i in range(len(found)):
        for k, digit in enumerate((i % _LATTICE, i // _LATTICE % _LATTICE, i // _LATTICE**2)):
            end[k] = box[k, 0] + size[k] * digit / (_LATTICE - 1)
        t, p, q = _segments(kind, pose, end)
        found[i] = t + p + q
    best, segments = math.inf, (math.inf, 0.0, 0.0)
    for _ in range(_ENDS):
        i = int(np.argmin(found))
        if found[i] == math.inf:
            break
        for k, digit in enumerate((i % _LATTICE, i // _LATTICE % _LATTICE, i // _LATTICE**2)):
            end[k] = box[k, 0] + size[k] * digit / (_LATTICE - 1)
        length, step = found[i], 1.0 / (_LATTICE - 1)
        found[i] = math.inf
        while step > 1e-6:
            better = False
            for k in range(6):
                side = k // 2
                before = end[side]
                end[side] += (step if k % 2 else -step) * size[side]
                end[side] = min(max(end[side], box[side, 0]), box[side, 1])
                t, p, q = _segments(kind, pose, end)
                if t + p + q < length - 1e-12:
                    length, better = t + p + q, True
                else:
                    end[side] = before
            if not better:
                step /= 2.0
        if length < best:
            best, segments = length, _segments(kind, pose, end)
    return segments


@cached_njit
def to_box(states: Array, box: Array) -> tuple[Array, Array]:
    """Find the shortest paths from states (N, 3) to the box (3, 2).

    Returns lengths (N,) and the paths (N, 4): word, and its three segments.

    Over the poses of the box, the length jumps by a full turn where a turn vanishes. So each word is also searched over
    its own parameters: given the first turn and the arrival heading (or the first two of three turns), the rest
    follows. That search, in turn, gets stuck where paths end at an edge of the box.
    """
    lengths, paths = np.empty(len(states)), np.zeros((len(states), 4))
    best, firsts, seconds = np.empty(_STARTS), np.empty(_STARTS), np.empty(_STARTS)
    for n in range(len(states)):
        pose = states[n]
        x, y, a = pose
        if _inside(x, y, a, box):
            lengths[n] = 0.0
            continue
        lengths[n] = math.inf
        away = math.hypot(max(box[0, 0] - x, 0.0, x - box[0, 1]), max(box[1, 0] - y, 0.0, y - box[1, 1]))
        # Also try the current heading, clipped to the arrival headings.
        own = box[2, 0] + min((a - box[2, 0]) % (2.0 * math.pi), box[2, 1] - box[2, 0])
        for kind in range(6):
            if kind >= 4 and away > _THREE_TURNS:
                continue
            best[:] = math.inf
            outer, inner = (_HEADINGS + 1, _AIMS) if kind < 4 else (_TURNS, _TURNS)
            for i in range(outer):
                if kind < 4:
                    one = own if i == _HEADINGS else box[2, 0] + (box[2, 1] - box[2, 0]) * i / (_HEADINGS - 1)
                else:
                    one = 2.0 * math.pi * i / _TURNS
                for j in range(inner):
                    two = _aim(kind, pose, one, box, j) if kind < 4 else 2.0 * math.pi * j / _TURNS
                    t, p, q = _path(kind, pose, one, two, box)
                    worst = np.argmax(best)
                    if t + p + q < best[worst]:
                        best[worst], firsts[worst], seconds[worst] = t + p + q, one, two
            t, p, q = _between(kind, pose, box)
            if t + p + q < lengths[n]:
                lengths[n] = t + p + q
                paths[n, 0], paths[n, 1], paths[n, 2], paths[n, 3] = kind, t, p, q
            for k in range(_STARTS):
                if best[k] < math.inf:
                    t, p, q = _refine(kind, pose, firsts[k], seconds[k], box)
                    if t + p + q < lengths[n]:
                        lengths[n] = t + p + q
                        paths[n, 0], paths[n, 1], paths[n, 2], paths[n, 3] = kind, t, p, q
    return lengths, paths


@cached_njit
def stays_in(states: Array, paths: Array, low: float, high: float) -> NDArray[np.bool_]:
    """Return whether the path (N, 4) of `to_box` from each state keeps x and y in [low, high], shape (N,)."""
    out = np.ones(len(states), np.bool_)
    for n in range(len(states)):
        x, y, a = states[n]
        kind, t, p, q = int(paths[n, 0]), paths[n, 1], paths[n, 2], paths[n, 3]
        for i in range(int((t + p + q) / 0.01) + 1):
            px, py, _ = end_of(kind, t, p, q, x, y, a, i * 0.01)
            if not (low <= px <= high and low <= py <= high):
                out[n] = False
                break
    return out

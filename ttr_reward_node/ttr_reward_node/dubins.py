"""The independent reference: shortest Dubins paths (Dubins 1957; words as in Shkel, Lumelsky 2001) to a box of poses.

The car drives at 1 m/s and turns at up to 1 rad/s, so lengths [m] are times [s]. The distance to a box is the least
over its poses: first over a lattice of them, then by a compass search from the best few down to 1e-5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.units import Interval
from numpy.typing import NDArray

from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.machine_code import cached
from ttr_reward_node.problem import Problem

Array = NDArray[np.float64]
LSL, RSR, LSR, RSL, RLR, LRL = range(6)
TURNS = np.array([[1, 0, 1], [-1, 0, -1], [1, 0, -1], [-1, 0, 1], [-1, 1, -1], [1, -1, 1]])


@dataclass(frozen=True, eq=False)
class Reference:
    """States (N, 3) and their exact times to reach (N,) [s]."""

    states: Array
    times: Array


def reference(problem: Problem, count: int = 5000, seed: int = 0) -> Reference:
    """Draw random states outside the target from which the shortest path stays on the grid, with their exact times.

    Args:
        problem: a Dubins car at 1 m/s and up to 1 rad/s, a box as the target; obstacles do not count.
        count: how many states.
        seed: of the random states.

    Raises:
        TimeToReachError: another system or target.
    """
    names, target = problem.system.state_names, problem.target.intervals
    bounds = problem.system.control_bounds.T.tolist()
    if names != ("x", "y", "theta") or bounds != [[1.0, 1.0], [-1.0, 1.0]] or set(target) != set(names):
        raise TimeToReachError("exact times are known for the Dubins car of 1 m/s and 1 rad/s to a box of poses")
    sides: list[Interval] = [target[name] for name in names]
    box = np.array([(side.low, side.high) for side in sides])
    lower, upper = np.array([(axis.lower, axis.upper) for axis in problem.axes]).T
    low, high = float(max(lower[:2])), float(min(upper[:2]))
    random = np.random.default_rng(seed)
    states, times = np.empty((0, 3)), np.empty(0)
    while len(times) < count:
        some = random.uniform(lower, upper, (count, 3))
        lengths, poses = to_box(some, box, 9, 6)
        kept = stays_in(some, poses, low, high) & (lengths > 0.0)
        states, times = np.concatenate((states, some[kept])), np.concatenate((times, lengths[kept]))
    return Reference(states[:count], times[:count])


@cached
def _mod(angle: float) -> float:
    angle = angle % (2 * math.pi)
    return 0.0 if angle > 2 * math.pi - 1e-12 else angle


@cached
def word(kind: int, x: float, y: float, angle: float) -> tuple[float, float, float]:
    """Return segments (t, p, q) of one word from the origin to (x, y, angle); inf where it does not exist."""
    none = (math.inf, math.inf, math.inf)
    d = math.hypot(x, y)
    direction = math.atan2(y, x)
    a, b = -direction, angle - direction
    sa, ca, sb, cb, cab = math.sin(a), math.cos(a), math.sin(b), math.cos(b), math.cos(a - b)
    if kind == 0 or kind == 1:
        s = 1.0 if kind == 0 else -1.0
        square = 2 + d * d - 2 * cab + 2 * s * d * (sa - sb)
        if square < 0:
            if square < -1e-12:
                return none
            square = 0.0
        turn = math.atan2(s * (cb - ca), d + s * (sa - sb))
        return _mod(s * (turn - a)), math.sqrt(square), _mod(s * (b - turn))
    if kind == 2 or kind == 3:
        s = 1.0 if kind == 2 else -1.0
        square = -2 + d * d + 2 * cab + 2 * s * d * (sa + sb)
        if square < 0:
            return none
        p = math.sqrt(square)
        turn = math.atan2(-s * (ca + cb), d + s * (sa + sb)) - math.atan2(-s * 2.0, p)
        return _mod(s * (turn - a)), p, _mod(s * (turn - b))
    s = 1.0 if kind == 4 else -1.0
    cosine = (6 - d * d + 2 * cab + 2 * s * d * (sa - sb)) / 8
    if abs(cosine) > 1:
        return none
    p = _mod(2 * math.pi - math.acos(cosine))
    t = (
        _mod(s * a - math.atan2(s * (ca - cb), d - s * (sa - sb)) * s * s + p / 2)
        if kind == 4
        else _mod(-a - math.atan2(ca - cb, d + sa - sb) + p / 2)
    )
    q = _mod(a - b - t + p) if kind == 4 else _mod(b - a - t + p)
    return t, p, q


@cached
def end_of(
    kind: int, t: float, p: float, q: float, x: float, y: float, angle: float, s: float
) -> tuple[float, float, float]:
    """Return the pose after s metres of the word with these segments."""
    lengths = (t, p, q)
    for i in range(3):
        step = min(s, lengths[i])
        turn = TURNS[kind, i]
        if turn == 0:
            x += step * math.cos(angle)
            y += step * math.sin(angle)
        else:
            x += turn * (math.sin(angle + turn * step) - math.sin(angle))
            y -= turn * (math.cos(angle + turn * step) - math.cos(angle))
            angle += turn * step
        s -= step
    return x, y, angle


@cached
def distance(x0: float, y0: float, a0: float, x1: float, y1: float, a1: float) -> tuple[float, int]:
    """Return the length of the shortest path between two poses, and its word."""
    c, s = math.cos(a0), math.sin(a0)
    dx, dy = x1 - x0, y1 - y0
    x, y = c * dx + s * dy, -s * dx + c * dy
    best, kind = math.inf, -1
    for k in range(6):
        t, p, q = word(k, x, y, a1 - a0)
        if t + p + q < best:
            best, kind = t + p + q, k
    return best, kind


@cached
def to_box(states: Array, box: Array, lattice: int, starts: int) -> tuple[Array, Array]:
    """Find the shortest paths from states (N, 3) to box (3, 2).

    Returns lengths (N,) and poses (N, 3) of arrival. `lattice` poses a side are tried, `starts` of them refined.
    """
    out, poses = np.empty(len(states)), np.empty((len(states), 3))
    candidates = np.empty((lattice**3, 3))
    size = box[:, 1] - box[:, 0]
    for i in range(lattice**3):
        for k, digit in enumerate((i % lattice, i // lattice % lattice, i // lattice**2)):
            candidates[i, k] = box[k, 0] + size[k] * digit / (lattice - 1)
    lengths = np.empty(len(candidates))
    for n in range(len(states)):
        x, y, a = states[n]
        inside = (a - box[2, 0]) % (2 * math.pi) <= size[2]
        if box[0, 0] <= x <= box[0, 1] and box[1, 0] <= y <= box[1, 1] and inside:
            out[n], poses[n] = 0.0, states[n]
            continue
        for i in range(len(candidates)):
            lengths[i] = distance(x, y, a, candidates[i, 0], candidates[i, 1], candidates[i, 2])[0]
        order = np.argsort(lengths)[:starts]
        out[n] = math.inf
        for i in order:
            pose, best = candidates[i].copy(), lengths[i]
            step = 1.0 / (lattice - 1)
            while step > 1e-5:
                better = False
                for k in range(3):
                    for sign in (-1.0, 1.0):
                        old = pose[k]
                        pose[k] = min(max(old + sign * step * size[k], box[k, 0]), box[k, 1])
                        length = distance(x, y, a, pose[0], pose[1], pose[2])[0]
                        if length < best - 1e-12:
                            best, better = length, True
                        else:
                            pose[k] = old
                if not better:
                    step /= 2
            if best < out[n]:
                out[n], poses[n] = best, pose
    return out, poses


@cached
def stays_in(states: Array, poses: Array, low: float, high: float) -> NDArray[np.bool_]:
    """Tell whether the shortest path from each state to its pose keeps x and y in [low, high], (N,)."""
    out = np.ones(len(states), np.bool_)
    for n in range(len(states)):
        x, y, a = states[n]
        c, s = math.cos(a), math.sin(a)
        dx, dy = poses[n, 0] - x, poses[n, 1] - y
        length, kind = distance(x, y, a, poses[n, 0], poses[n, 1], poses[n, 2])
        t, p, q = word(kind, c * dx + s * dy, -s * dx + c * dy, poses[n, 2] - a)
        for i in range(int(length / 0.01) + 1):
            px, py, _ = end_of(kind, t, p, q, x, y, a, i * 0.01)
            if not (low <= px <= high and low <= py <= high):
                out[n] = False
                break
    return out
